from .chains import mjcf_of, mjcf_of_plant, plant_of_text, text_of
from .corrected import (
    CorrectedModel,
    passive_forces,
    save_mjcf,
    write_corrected_mjcf,
    write_joint_terms,
)
from .edited_model import FAR, EditedModel
from .inertials import Inertials
from .models import chain_of, load_mjcf, plant_of, plant_of_model
from .mujoco.callbacks import SteppedModel, install_correction
from .mujoco.plant import MujocoPlant
from .mujoco.read import Physics, mujoco_plant, read_plant
from .mujoco.touching import spans_touching

__all__ = [
    "FAR",
    "CorrectedModel",
    "EditedModel",
    "Inertials",
    "MujocoPlant",
    "Physics",
    "SteppedModel",
    "chain_of",
    "install_correction",
    "load_mjcf",
    "mjcf_of",
    "mjcf_of_plant",
    "mujoco_plant",
    "passive_forces",
    "plant_of",
    "plant_of_model",
    "plant_of_text",
    "read_plant",
    "save_mjcf",
    "spans_touching",
    "text_of",
    "write_corrected_mjcf",
    "write_joint_terms",
]
