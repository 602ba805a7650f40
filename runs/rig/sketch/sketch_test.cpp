// The sketch on a computer: a stub of its hardware, whose serial line is standard input and output.
// A motor moves a mass of 1 kg; the pole hangs still.

#include <poll.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>
#include <unistd.h>

#include <cstdint>

#define HARDWARE_STUB
enum { LOW, HIGH, INPUT_PULLUP, OUTPUT, CHANGE, A0 };

static int pwm = 0, direction = 0;
static double x = 0.0, v = 0.0;

static uint32_t micros() {
  timespec t;
  clock_gettime(CLOCK_MONOTONIC, &t);
  return (uint32_t)(t.tv_sec * 1000000ull + t.tv_nsec / 1000);
}

struct {
  void begin(long) {}
  int available() {
    pollfd in = {0, POLLIN, 0};
    return poll(&in, 1, 1) > 0;
  }
  int read() {
    unsigned char byte;
    if (::read(0, &byte, 1) != 1) exit(0);  // the other end has gone
    return byte;
  }
  void write(uint8_t byte) { write(&byte, 1); }
  void write(const uint8_t* bytes, int n) {
    if (n && ::write(1, bytes, n) != n) exit(1);
  }
} Serial;

static int digitalRead(int pin) { return pin == 7 && x < 0.0 ? LOW : HIGH; }  // the home switch
static void digitalWrite(int, int level) { direction = level ? 1 : -1; }
static void analogWrite(int, int level) { pwm = level; }
static int analogRead(int) { return 7; }
static void pinMode(int, int) {}
static int digitalPinToInterrupt(int pin) { return pin; }
static void attachInterrupt(int, void (*)(), int) {}
static void noInterrupts() {}
static void interrupts() {}
static void randomSeed(int seed) { srandom(seed); }
static long random(long low, long high) { return low + ::random() % (high - low); }

#include "sketch.ino"

int main() {
  setup();
  uint32_t before = micros();
  int32_t counted = 0;
  for (;;) {
    const uint32_t now = micros();
    const double h = 1e-6 * (now - before), newtons = direction * pwm / 255.0 * NEWTONS_AT_FULL_PWM;
    v += h * (newtons - 20.0 * v);
    x += h * v;
    before = now;
    const int32_t raw = (int32_t)(x / METRES_A_COUNT);
    cart_count += raw - counted;
    counted = raw;
    loop();
  }
}
