"""The kinematics of an unknown robot, from markers that a camera sees (thesis chapter 2).

`triplet_tests` asks of any two markers and a joint whether the joint connects their links;
`find_chain` puts markers and joints in order, a `KinematicChain` of hinges and slides.
`fit_forward` learns where the last marker is (`ForwardKinematics`), `prediction_errors` judges it
on frames that it has not seen, and `reach` plans joint motions to a pose.

Read `triplets`, `chain`, `forward`, `controller`. Recordings are
`mcpilco.recordings.MarkerRecording`.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
