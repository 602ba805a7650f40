// A cart on a rail, its motor and two encoders, at the other end of a serial line: the machine's
// side of the protocol in docs/machine.md, for boards of the Arduino kind (AVR, ARM, ESP32).
// What is yours stands in the first part: pins, units, limits, and the way home.
// The same file is compiled with g++ against a stub of the hardware (sketch_test.cpp).

#ifndef HARDWARE_STUB
#include <Arduino.h>
#endif
#include <math.h>
#include <stdint.h>
#include <string.h>

// ---- your machine -------------------------------------------------------------------------------

const uint8_t PIN_PWM = 9, PIN_DIRECTION = 8, PIN_HOME_SWITCH = 7;
const uint8_t PIN_CART_A = 2, PIN_CART_B = 4, PIN_POLE_A = 3, PIN_POLE_B = 5;
const float METRES_A_COUNT = 2.275e-5f, RADIANS_A_COUNT = 6.2831853f / 4096.0f;
const float NEWTONS_AT_FULL_PWM = 10.0f;   // what the driver gives at 255
const float RAIL = 0.4f;                   // beyond it the motor is off, whoever asks [m]
const uint32_t WATCHDOG_US = 300000;       // without a command for so long the motor is off
const float HOME_SPEED_PWM = 40.0f;        // towards the switch
const float FILTER_S = 0.01f;              // of the velocities [s]
const uint32_t STILL_US = 1000000;         // at rest for so long: it is at its start
const char KEY[] = "";                     // as in the key file of the learner

volatile int32_t cart_count = 0, pole_count = 0;
void on_cart() { cart_count += digitalRead(PIN_CART_A) == digitalRead(PIN_CART_B) ? 1 : -1; }
void on_pole() { pole_count += digitalRead(PIN_POLE_A) == digitalRead(PIN_POLE_B) ? 1 : -1; }

// ---- frames -------------------------------------------------------------------------------------

enum { HELLO = 1, WELCOME, COMMAND, MEASUREMENT };
enum { SAFE = 0, RUN, HOME, STOP, READY };
const uint8_t HEAD = 32, TAG = 8, STATES = 4, INPUTS = 1, LARGEST = HEAD + 4 * (STATES + INPUTS) + TAG;

template <typename T> T load(const uint8_t* from) { T value; memcpy(&value, from, sizeof value); return value; }
template <typename T> void store(uint8_t* to, T value) { memcpy(to, &value, sizeof value); }

// BLAKE2s (RFC 7693) with 8 bytes of output, over at most 64 bytes of key and one frame
static uint32_t h[8];
static const uint32_t IV[8] = {0x6A09E667, 0xBB67AE85, 0x3C6EF372, 0xA54FF53A,
                               0x510E527F, 0x9B05688C, 0x1F83D9AB, 0x5BE0CD19};
static const uint8_t SIGMA[10][16] = {
    {0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15}, {14, 10, 4, 8, 9, 15, 13, 6, 1, 12, 0, 2, 11, 7, 5, 3},
    {11, 8, 12, 0, 5, 2, 15, 13, 10, 14, 3, 6, 7, 1, 9, 4}, {7, 9, 3, 1, 13, 12, 11, 14, 2, 6, 5, 10, 4, 0, 15, 8},
    {9, 0, 5, 7, 2, 4, 10, 15, 14, 1, 11, 12, 6, 8, 3, 13}, {2, 12, 6, 10, 0, 11, 8, 3, 4, 13, 7, 5, 15, 14, 1, 9},
    {12, 5, 1, 15, 14, 13, 4, 10, 0, 7, 6, 3, 9, 2, 8, 11}, {13, 11, 7, 14, 12, 1, 3, 9, 5, 0, 15, 4, 8, 6, 2, 10},
    {6, 15, 14, 9, 11, 3, 0, 8, 12, 2, 13, 7, 1, 4, 10, 5}, {10, 2, 8, 4, 7, 6, 1, 5, 15, 11, 9, 14, 3, 12, 13, 0}};

static uint32_t turned(uint32_t x, uint8_t by) { return x >> by | x << (32 - by); }

static void mix(uint32_t* v, uint8_t a, uint8_t b, uint8_t c, uint8_t d, uint32_t x, uint32_t y) {
  v[a] += v[b] + x; v[d] = turned(v[d] ^ v[a], 16);
  v[c] += v[d]; v[b] = turned(v[b] ^ v[c], 12);
  v[a] += v[b] + y; v[d] = turned(v[d] ^ v[a], 8);
  v[c] += v[d]; v[b] = turned(v[b] ^ v[c], 7);
}

static void compress(const uint8_t* block, uint32_t bytes, bool last) {
  uint32_t v[16], m[16];
  for (uint8_t i = 0; i < 16; i++) m[i] = load<uint32_t>(block + 4 * i);
  for (uint8_t i = 0; i < 8; i++) { v[i] = h[i]; v[i + 8] = IV[i]; }
  v[12] ^= bytes;
  if (last) v[14] = ~v[14];
  for (uint8_t r = 0; r < 10; r++) {
    const uint8_t* s = SIGMA[r];
    for (uint8_t i = 0; i < 4; i++) mix(v, i, i + 4, i + 8, i + 12, m[s[2 * i]], m[s[2 * i + 1]]);
    for (uint8_t i = 0; i < 4; i++)
      mix(v, i, (i + 1) % 4 + 4, (i + 2) % 4 + 8, (i + 3) % 4 + 12, m[s[2 * i + 8]], m[s[2 * i + 9]]);
  }
  for (uint8_t i = 0; i < 8; i++) h[i] ^= v[i] ^ v[i + 8];
}

static void tag_of(const uint8_t* content, uint8_t length, uint8_t* out) {
  const uint8_t key = sizeof KEY - 1;
  uint8_t block[64];
  uint32_t done = 0;
  memcpy(h, IV, sizeof h);
  h[0] ^= 0x01010000u ^ (uint32_t)key << 8 ^ TAG;
  if (key) {
    memset(block, 0, sizeof block);
    memcpy(block, KEY, key);
    compress(block, done = 64, false);
  }
  do {
    const uint8_t part = length < 64 ? length : 64;
    memset(block, 0, sizeof block);
    memcpy(block, content, part);
    content += part;
    length -= part;
    compress(block, done += part, length == 0);
  } while (length);
  memcpy(out, h, TAG);
}

// ---- the session --------------------------------------------------------------------------------

uint64_t session = 0, pending = 0;
uint32_t counter = 0, last = 0, heard = 0, refused = 0;
uint8_t mode = STOP;
float force = 0.0f;
uint8_t line[2 * LARGEST], filled = 0;
bool overflow = false;

uint64_t micros64() {  // micros() begins anew after 71 minutes
  static uint32_t before = 0, turns = 0;
  const uint32_t now = micros();
  turns += now < before;
  before = now;
  return (uint64_t)turns << 32 | now;
}

void drive(float newtons) {
  force = newtons;
  const float share = fminf(fabsf(newtons) / NEWTONS_AT_FULL_PWM, 1.0f);
  digitalWrite(PIN_DIRECTION, newtons > 0.0f ? HIGH : LOW);
  analogWrite(PIN_PWM, (int)(255.0f * share + 0.5f));
}

void post(uint8_t kind, uint64_t of, uint32_t number, uint32_t echo, uint8_t status, const float* values, uint8_t n) {
  uint8_t frame[LARGEST] = {'M', 'P', 1, kind};
  store(frame + 4, of);
  store(frame + 12, number);
  store(frame + 16, echo);
  store(frame + 20, micros64());
  frame[28] = status;
  frame[29] = n;
  memcpy(frame + HEAD, values, 4 * n);
  const uint8_t length = HEAD + 4 * n;
  tag_of(frame, length, frame + length);
  const uint8_t whole = length + TAG;
  for (uint8_t at = 0; at <= whole;) {  // consistent overhead byte stuffing
    uint8_t end = at;
    while (end < whole && frame[end]) end++;
    Serial.write((uint8_t)(end - at + 1));
    Serial.write(frame + at, end - at);
    at = end + 1;
  }
  Serial.write((uint8_t)0);
}

float cart = 0.0f, pole = 0.0f, cart_speed = 0.0f, pole_speed = 0.0f;
uint32_t sensed = 0, moved = 0;

void sense() {
  const uint32_t now = micros();
  const float span = 1e-6f * (now - sensed);
  if (span < 1e-3f) return;
  noInterrupts();
  const int32_t c = cart_count, p = pole_count;
  interrupts();
  const float x = c * METRES_A_COUNT, q = p * RADIANS_A_COUNT, share = span / (FILTER_S + span);
  if (x != cart || q != pole) moved = now;
  cart_speed += share * ((x - cart) / span - cart_speed);
  pole_speed += share * ((q - pole) / span - pole_speed);
  cart = x;
  pole = q;
  sensed = now;
}

bool homed = false;

void go_home() {  // to the switch, then wait until the pole hangs still, which is where zero is
  if (homed) return;
  const bool there = digitalRead(PIN_HOME_SWITCH) == LOW;
  drive(there ? 0.0f : -HOME_SPEED_PWM / 255.0f * NEWTONS_AT_FULL_PWM);
  if (!there || micros() - moved < STILL_US) return;
  noInterrupts();
  cart_count = pole_count = 0;
  interrupts();
  cart = pole = cart_speed = pole_speed = 0.0f;
  homed = true;
}

void obey(uint8_t asked, float newtons) {
  if (mode == STOP) asked = STOP;  // until another session
  if (asked == HOME && mode != HOME) {
    homed = false;
    moved = micros();
  }
  mode = asked;
  const bool inside = fabsf(cart) < RAIL || (cart > 0.0f) != (newtons > 0.0f);
  if (mode != HOME) drive(mode == RUN && inside ? newtons : 0.0f);
}

void hear(const uint8_t* f, uint8_t length) {  // a frame; what is none changes nothing
  refused++;
  if (length < HEAD + TAG || length > LARGEST || f[0] != 'M' || f[1] != 'P' || f[2] != 1) return;
  const uint8_t kind = f[3], asked = f[28], n = f[29];
  if (f[30] || f[31] || asked > STOP || length != HEAD + 4 * n + TAG) return;
  uint8_t tag[TAG];
  tag_of(f, length - TAG, tag);
  if (memcmp(tag, f + length - TAG, TAG)) return;
  const uint64_t of = load<uint64_t>(f + 4);
  const uint32_t number = load<uint32_t>(f + 12), now = micros();
  if (kind == HELLO && n == 0 && of && !(of >> 32)) {
    if (mode != STOP && now - heard < WATCHDOG_US) return;  // one session at a time
    if ((uint32_t)pending != of) pending = of | (uint64_t)(random(1, 0x7FFFFFFF) ^ now) << 32;
    const float about[3] = {STATES, INPUTS, 1e-6f * WATCHDOG_US};
    refused--;
    return post(WELCOME, pending, 1, 1, SAFE, about, 3);
  }
  const float newtons = load<float>(f + HEAD);
  if (kind != COMMAND || n != INPUTS || !isfinite(newtons)) return;
  if (pending && of == pending) {
    session = of;
    pending = last = counter = 0;
    mode = SAFE;
  }
  if (!session || of != session || number <= last) return;
  refused--;
  last = number;
  heard = now;
  obey(asked, newtons);
  sense();
  const float values[STATES + INPUTS] = {cart, cart_speed, pole, pole_speed, force};
  post(MEASUREMENT, session, ++counter, number, mode == HOME && homed ? (uint8_t)READY : mode, values, STATES + INPUTS);
}

void take(uint8_t byte) {  // one of the serial line
  if (byte) {
    if (filled == sizeof line) overflow = true;
    else line[filled++] = byte;
    return;
  }
  uint8_t out = 0, at = 0;
  bool whole = !overflow && filled > 0;
  while (whole && at < filled) {
    const uint8_t part = line[at];
    whole = at + part <= filled;
    for (uint8_t i = 1; whole && i < part; i++) line[out++] = line[at + i];
    at += part;
    if (whole && at < filled) line[out++] = 0;
  }
  if (whole) hear(line, out);
  else if (overflow || filled) refused++;
  filled = 0;
  overflow = false;
}

void setup() {
  Serial.begin(115200);
  pinMode(PIN_PWM, OUTPUT);
  pinMode(PIN_DIRECTION, OUTPUT);
  pinMode(PIN_HOME_SWITCH, INPUT_PULLUP);
  attachInterrupt(digitalPinToInterrupt(PIN_CART_A), on_cart, CHANGE);
  attachInterrupt(digitalPinToInterrupt(PIN_POLE_A), on_pole, CHANGE);
  randomSeed(analogRead(A0));
  drive(0.0f);
}

void loop() {
  while (Serial.available() > 0) take((uint8_t)Serial.read());
  sense();
  if (mode != STOP && micros() - heard > WATCHDOG_US) {
    mode = SAFE;
    drive(0.0f);
  }
  if (mode == HOME) go_home();
}
