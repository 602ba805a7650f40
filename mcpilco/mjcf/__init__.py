"""MJCF in and out: models of MuJoCo as plants, and corrections as models.

`models` makes a plant of equations of a MuJoCo model; where equations cannot say it, MuJoCo itself
simulates it (`mujoco/`), and `read_plant` chooses. An effect writes itself into an `EditedModel`,
a compiled one or one of MJCF; `corrected` makes a file of a correction, and says what is not in it.

Read `models`, `edited_model`, `corrected`, `mujoco/plant`.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
