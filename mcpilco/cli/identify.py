"""`mcpilco identify`: masses, inertias and friction of a robot, from its recordings."""

from __future__ import annotations

import json
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from mcpilco.cli import options
from mcpilco.typing import InputError

if TYPE_CHECKING:
    from mcpilco.identification import Identified

Method = Literal[
    "EIV",
    "IV",
    "IDIM-IV",
    "OLS",
    "ridge",
    "stepwise",
    "PLS",
    "LASSO",
    "JFA-b_true",
    "VB-b_noise",
    "VB-b_true",
]
"""names of methods on the command line, without spaces"""

Term = Literal["viscous", "coulomb", "armature", "stiffness", "offset"]
"""what a joint may have besides its body"""


@dataclass(frozen=True)
class Identify(options.Command):
    """Find the masses, inertias and friction of a robot in recordings of its motion."""

    recordings: options.Files
    """CSV, npz, mat or parquet, with the columns `time`, `<joint>_position` and `<joint>_torque`
    (of a slide `<joint>_force`) or a command for each motor"""
    model: Annotated[str, tyro.conf.arg(metavar="ID|FILE.xml")]
    """a registered plant, or an MJCF of the robot: joints and frames are taken from it"""
    out: Annotated[Path, tyro.conf.arg(metavar="FOLDER")]
    """folder for identified.json, which --prior of `mcpilco train` reads, and identified.xml"""
    method: Method = "EIV"
    """the regression; EIV: errors in variables; IV: instruments from `<joint>_reference`; IDIM-IV:
    from simulations of the robot that follows it"""
    projection: Literal["none", "virtual", "pseudo-inertia"] = "pseudo-inertia"
    """on parameters of bodies that can exist; virtual: eq. (5) of Ting et al., which is less"""
    rows: Literal["weighted", "plain"] = "weighted"
    """weighted: by the error of each joint's force"""
    terms: tuple[Term, ...] = ("viscous", "coulomb")
    """what is to be found of each joint; all else stays as in the model"""
    filter: Literal["zero-phase", "local-cubics"] = "zero-phase"
    """for velocities and accelerations"""
    cutoff: Annotated[float | None, options.optional("HZ", "four times the motion's bandwidth")] = (
        None
    )
    """of the zero-phase filter [Hz]"""
    held_out: float = 0.2
    """share at the end of each recording that is not fitted to, but tested on"""
    columns: options.Columns = ()
    """what the files call time, positions and forces, where it differs; also separated by commas"""
    dt: Annotated[float | None, options.optional("FLOAT", "that of each recording")] = None
    """sampling time to which all are brought [s]"""

    def __call__(self) -> int:
        options.use_one_thread()
        options.register("" if options.is_model(self.model) else self.model)
        from mcpilco.files import make_folder, write_bytes
        from mcpilco.identification import write_identified_mjcf

        with tempfile.TemporaryDirectory() as folder:
            source, plant, columns = self._source(Path(folder))
            found = self._identify(source, columns)
            for line in lines(found):
                print(line)
            make_folder(self.out, "identified.json", "identified.xml")
            written = ["identified.json"]
            with options.without("identified.xml"):
                path = self.out / "identified.xml"
                write_identified_mjcf(source, found.body, found.theta, path)
                written.append(path.name)
        told = self._prior(plant, found) | {"about": as_json(found)}
        write_bytes(self.out / "identified.json", json.dumps(told, indent=1).encode())
        print(f"In {self.out}: {', '.join(written)}.")
        return 0

    def _source(self, folder: Path) -> tuple[Path, Any, dict[str, str]]:
        """The robot's MJCF, the plant where it is a registered one, and its names of columns."""
        if options.is_model(self.model):
            return Path(self.model), None, {}
        from envs import plant_named
        from mcpilco.files import write_bytes
        from mcpilco.mjcf import mjcf_of_plant

        plant: Any = plant_named("--model", self.model)
        layout, path = plant.layout, folder / "plant.xml"
        write_bytes(path, mjcf_of_plant(plant).encode())
        kinds = ("position", "velocity")
        names = [f"{joint}_{kind}" for joint in layout.joints for kind in kinds]
        return path, plant, dict(zip(names, layout.states, strict=True))

    def _prior(self, plant: Any, found: Identified) -> dict[str, Any]:
        """The correction of the plant, or of the identified model, as JSON."""
        from mcpilco.identification import correction_of_identified
        from mcpilco.mjcf import plant_of, text_of
        from mcpilco.plant import correction_json

        with options.without("a prior in identified.json"):
            path, text = self.out / "identified.xml", ""
            if plant is None:
                plant, text = plant_of(path), text_of(path)
            correction = correction_of_identified(plant, found)
            return correction_json(replace(correction, mjcf=text))
        return {}

    def _identify(self, source: Path, columns: dict[str, str]) -> Identified:
        import warnings

        from mcpilco.identification import Recipe, UnidentifiedWarning, identify
        from mcpilco.recordings import load_robot, read_robot

        model = load_robot(source)
        method = self.method.replace("-b_", " b_")  # as the package calls it
        recipe = Recipe(method, self.projection, self.rows)
        segments, errors, remarks = read_robot(
            self.recordings, model, columns | options.column_names(self.columns), self.dt
        )
        options.warn(*errors, about="left out")
        if not segments:
            raise InputError("none of the recordings can be read; mend one of the faults above.")
        for remark in remarks:
            print(remark, file=sys.stderr)
        with warnings.catch_warnings(record=True) as told:
            warnings.simplefilter("ignore")
            warnings.simplefilter("always", UnidentifiedWarning)
            found = identify(
                model,
                segments,
                recipe,
                terms=tuple(self.terms),
                filter=self.filter,
                cutoff=self.cutoff,
                held_out=self.held_out,
            )
        options.warn(*{str(warning.message) for warning in told}, about=self.method)
        return found


def lines(found: Identified) -> Iterator[str]:
    """The results as printed lines."""
    base, body = found.base, found.body
    fitted, tested = found.rows
    yield f"{fitted} rows a joint fitted, {tested} held out; cutoff {found.cutoff:.3g} Hz."
    yield f"{len(base)} base parameters are identifiable, of {len(body.names)} parameters:"
    table = [
        (f"{value:.5g}", f"+- {half:.2g}", body.units[at], formula)
        for value, half, at, formula in zip(
            found.beta, found.half_width, base.independent, base.formulas(body.names), strict=True
        )
    ]
    yield from _aligned([("value", "95 %", "unit", "parameter"), *table])
    yield "Links, before and after the projection:"
    links = zip(found.before, found.after, strict=True)
    yield from _aligned(
        [(pair[0].name, *("; ".join(o.faults) or "consistent" for o in pair)) for pair in links]
    )
    held = "held-out rows" if tested else "the rows fitted to"
    yield f"RMS of the forces in {held}, and of the residuals of both models:"
    errors = zip(body.chain.joints, found.force, found.error, found.nominal_error, strict=True)
    rows = [(joint, *(f"{value:.4g}" for value in row)) for joint, *row in errors]
    yield from _aligned([("joint", "force", "identified", "model as it was"), *rows])
    yield from found.report.warnings


def _aligned(cells: list[tuple[str, ...]]) -> Iterator[str]:
    widths = [max(len(row[k]) for row in cells) for k in range(len(cells[0]))]
    for row in cells:
        yield "  " + "  ".join(cell.ljust(w) for cell, w in zip(row, widths, strict=True)).rstrip()


def as_json(found: Identified) -> dict[str, Any]:
    """All that was found, as JSON values."""
    body, base = found.body, found.base
    joints = body.chain.joints
    return {
        "recipe": {**vars(found.recipe), "cutoff_hz": found.cutoff},
        "parameters": {
            name: {"value": float(value), "before_projection": float(raw), "unit": unit}
            for name, value, raw, unit in zip(
                body.names, found.theta, found.estimate.raw, body.units, strict=True
            )
        },
        "base_parameters": [
            {"formula": formula, "value": float(value), "half_width_95": float(half), "unit": unit}
            for formula, value, half, unit in zip(
                base.formulas(body.names),
                found.beta,
                found.half_width,
                (body.units[at] for at in base.independent),
                strict=True,
            )
        ],
        "not_told_alone": list(found.report.unidentified),
        "links": {
            after.name: {
                "consistent": after.consistent,
                "before_projection": list(before.faults),
                "least_eigenvalue": after.least_eigenvalue,
            }
            for before, after in zip(found.before, found.after, strict=True)
        },
        "held_out": {
            joint: {
                "force_rms": float(force),
                "error_rms": float(error),
                "error_rms_of_the_model_as_it_was": float(was) if was == was else None,
            }
            for joint, force, error, was in zip(
                joints, found.force, found.error, found.nominal_error, strict=True
            )
        },
        "rows": {"fitted": found.rows[0], "held_out": found.rows[1]},
        "converged": found.report.converged,
        "warnings": list(found.report.warnings),
    }
