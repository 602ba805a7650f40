"""Volterra models as files of plain arrays."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch

from mcpilco.files import damaged, read_groups, write_groups
from mcpilco.identification.report import Report
from mcpilco.identification.volterra import Scaling, VolterraModel
from mcpilco.identification.volterra_prior import VolterraConfig, prior
from mcpilco.typing import McPilcoError

FORMAT = 1
"""of the files"""


def save_volterra(model: VolterraModel, path: Path) -> Path:
    """Write a model: hyperparameters, the samples that determine it, names and report.

    Raises:
        RunFolderError: the file cannot be written.
    """
    about = {
        "format": FORMAT,
        "config": dataclasses.asdict(model.config),
        "input_names": model.input_names,
        "output_names": model.output_names,
        "report": dataclasses.asdict(model.report),
    }
    groups = {
        "prior": model.gp.to_arrays(),
        "scaling": dataclasses.asdict(model.scaling),
        "samples": {"X": model.X.numpy(), "Y": model.Y.numpy()},
    }
    return write_groups(path, about, groups)


def load_volterra(path: str | Path) -> VolterraModel:
    """The model in a file, which predicts what it predicted when it was saved.

    Raises:
        RunFolderError: the file is missing, damaged, or no such model.
    """
    about, groups = read_groups(Path(path))
    try:
        return _model(about, groups)
    except (KeyError, TypeError, ValueError, AttributeError, McPilcoError) as error:
        raise damaged(Path(path), f"no Volterra model: {error}") from error


def _model(about: Mapping[str, Any], groups: Mapping[str, Mapping[str, Any]]) -> VolterraModel:
    if about["format"] != FORMAT:
        raise ValueError(f"format {about['format']!r}, expected {FORMAT}")
    config = VolterraConfig(**about["config"])
    names = tuple(about["input_names"]), tuple(about["output_names"])
    X, Y = (torch.as_tensor(np.asarray(groups["samples"][key], dtype=float)) for key in "XY")
    gp = prior(config, names[1], len(names[0]), len(X))
    gp.load_arrays(groups["prior"])
    told: dict[str, Any] = {
        name: tuple(value) if isinstance(value, list) else value
        for name, value in about["report"].items()
    }
    return VolterraModel(
        config=config,
        input_names=names[0],
        output_names=names[1],
        scaling=Scaling(**groups["scaling"]),
        gp=gp,
        X=X,
        Y=Y,
        posterior=gp.condition(X, Y),
        report=Report(**told),
    )
