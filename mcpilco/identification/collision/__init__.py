"""Collisions of an arm, detected from the currents of its motors alone (thesis chapter 4).

`fit_currents` learns a `CurrentModel` from samples without contact
(`mcpilco.recordings.arm_samples`): which current each motor takes, with friction at rest and in
motion. `thresholds` says how far a measured current may be from the expected one; a
`CollisionDetector` compares them sample by sample, `detect` a whole recording, and `events` gathers
the alarms.

Read `features`, `model`, `detector`.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
