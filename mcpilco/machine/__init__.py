"""Machines in real time: a protocol over UDP or a serial port, and a Gymnasium env in front of it.

    with meeting("udp://127.0.0.1:9000", log="logs"):
        env = gymnasium.make("mcpilco/Machine-v0", simulation="mcpilco/CartPoleSwingUp-v0")

`protocol` says what the frames are and which are refused, `link` carries them, `loop` is a process
of its own that keeps the time, the limits and the log, and `env` gives a learner steps of it. The
address of a machine is what a user types: no keyword of the env and no file names one.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
