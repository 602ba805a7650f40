"""A model of currents and its thresholds as one file of plain arrays and JSON."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

import numpy as np

from mcpilco.files import damaged, read_groups, write_groups
from mcpilco.identification.collision.detector import ThresholdConfig, Thresholds
from mcpilco.identification.collision.features import CURRENT_TERMS, CurrentFeatures
from mcpilco.identification.collision.model import CurrentConfig, CurrentModel, conditioned, prior
from mcpilco.identification.rigid_body import RigidBody, chain_of_json
from mcpilco.recordings import ArmSamples
from mcpilco.typing import McPilcoError, RunFolderError

FORMAT = "mcpilco collision model 1"


def save_collision_model(path: str | Path, model: CurrentModel, limits: Thresholds) -> Path:
    """The path of the file written; equal models give equal bytes.

    Raises:
        RunFolderError: the file cannot be written.
    """
    body = model.features.body
    about = {
        "format": FORMAT,
        "dt": model.dt,
        "config": asdict(model.config),
        "thresholds": asdict(limits.config),
        "chain": asdict(body.chain),
    }
    groups = {
        "samples": vars(model.train),
        "robot": {"nominal": body.nominal},
        "limits": {"moving": limits.moving, "resting": limits.resting},
    }
    groups |= {f"gp{j}": gp.to_arrays() for j, gp in enumerate(model.gps)}
    return write_groups(Path(path), about, groups)


def load_collision_model(path: str | Path) -> tuple[CurrentModel, Thresholds]:
    """The model and thresholds in a file; nothing in it is executed.

    Raises:
        RunFolderError: the file is missing, damaged, or something else.
    """
    path = Path(path)
    about, groups = read_groups(path)
    if about.get("format") != FORMAT:
        raise RunFolderError(
            f"{path} is no model of `mcpilco collisions learn` ({FORMAT!r}), got "
            f"{about.get('format')!r}; name the file that it wrote."
        )
    try:
        config = CurrentConfig(**about["config"])
        chain = chain_of_json(about["chain"])
        features = CurrentFeatures(
            RigidBody(chain, CURRENT_TERMS, groups["robot"]["nominal"]),
            config.quiet_speed,
            config.gate,
        )
        gps = tuple(prior(features, config))
        for j, gp in enumerate(gps):
            gp.load_arrays(groups[f"gp{j}"])
        train = ArmSamples(**groups["samples"])
        model, _ = conditioned(gps, train, features, float(about["dt"]), config)
        limits = Thresholds(ThresholdConfig(**about["thresholds"]), **groups["limits"])
        if not np.shape(limits.moving) == np.shape(limits.resting) == (features.joints,):
            raise ValueError("thresholds of another number of joints")
    except (KeyError, TypeError, ValueError, IndexError, McPilcoError) as error:
        raise damaged(path, error) from error
    return model, limits
