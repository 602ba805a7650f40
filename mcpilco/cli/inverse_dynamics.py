"""`mcpilco inverse-dynamics`: learn from recordings which torques a robot's motions take."""

from __future__ import annotations

import json
import sys
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from mcpilco.cli import options
from mcpilco.typing import InputError

if TYPE_CHECKING:
    from mcpilco.bodies import Chain
    from mcpilco.identification.inverse_dynamics import InverseDynamics as Model
    from mcpilco.kernels import Kind
    from mcpilco.recordings import JointData


@dataclass(frozen=True)
class InverseDynamics(options.Command):
    """Learn a robot's inverse dynamics from recordings, and test them on the end of each."""

    recordings: options.Files
    """CSV, npz, mat or parquet, with the columns `time`, `<joint>_position`, `<joint>_torque`; also
    `<joint>_velocity` and `<joint>_acceleration` where they are measured"""
    out: Annotated[Path, tyro.conf.arg(metavar="FOLDER")]
    """folder for model.npz, report.json and torques.png"""
    joints: Annotated[str | None, options.optional("HHSH", "those of --model")] = None
    """a letter for each joint in the order of the columns, H for a hinge and S for a slide"""
    model: Annotated[Path | None, options.optional("FILE.xml", "none")] = None
    """MJCF file of the robot, for the kernels that need its geometry"""
    kernel: Literal["gip", "rbf", "pp", "sp", "fe", "nn"] = "gip"
    """gip knows the kinds of the joints; pp, sp and fe the geometry; rbf and nn nothing"""
    frictionless: bool = False
    """leave friction out of the model"""
    samples: int = 2000
    """most samples to learn from, at a constant step; time grows as their cube"""
    hold_out: float = 0.2
    """share at the end of each recording that the model is tested on"""
    columns: options.Columns = ()
    """what the files call their columns, where it differs; also separated by commas"""
    dt: Annotated[float | None, options.optional("FLOAT", "that of each recording")] = None
    """sampling time to which all are brought [s]"""
    seed: int = 0
    """of the choice of samples that hyperparameters are fitted to"""

    def __call__(self) -> int:
        options.use_one_thread()
        from mcpilco.files import make_folder
        from mcpilco.identification.inverse_dynamics import (
            fit_inverse_dynamics,
            save_inverse_dynamics,
        )
        from mcpilco.mjcf import chain_of, load_mjcf

        if not self.recordings:
            raise InputError("expected at least one recording, got none; name a CSV file.")
        chain = None if self.model is None else chain_of(load_mjcf(self.model))
        train, test = self._data(chain)
        model = fit_inverse_dynamics(
            train.thinned(self.samples),
            self.kernel,
            chain=chain,
            friction=not self.frictionless,
            seed=self.seed,
        )
        nmse = model.nmse(test)
        make_folder(self.out, "model.npz", "report.json", "torques.png")
        save_inverse_dynamics(self.out / "model.npz", model)
        self._write_report(model, test, nmse.tolist())
        written = ["model.npz", "report.json", *self._draw(model, test)]
        print(f"{len(train.thinned(self.samples))} samples to learn from, {len(test)} to test on.")
        for joint, error, unit in zip(model.joints, nmse, _units(test), strict=True):
            std = test.tau[:, test.joints.index(joint)].std()
            print(f"{joint}: nMSE {error:.2e}, error {error**0.5 * std:.3g} of {std:.3g} {unit}")
        for warning in model.report.warnings:
            print(warning, file=sys.stderr)
        print(f"In {self.out}: {', '.join(written)}.")
        return 0

    def _data(self, chain: Chain | None) -> tuple[JointData, JointData]:
        from mcpilco.recordings import (
            JointData,
            check_joint_data,
            held_out,
            joint_data,
            read_joint_recordings,
        )

        joints, kinds = self._robot(chain)
        columns = options.column_names(self.columns)
        recordings = read_joint_recordings(self.recordings, joints, columns, self.dt)
        for recording in recordings:
            options.warn(*recording.remarks, about=recording.name)
        parts = [joint_data(recording, joints, kinds) for recording in recordings]
        check_joint_data(JointData.joined(parts))
        train, test = zip(*(held_out(part, self.hold_out) for part in parts), strict=True)
        return JointData.joined(train), JointData.joined(test)

    def _robot(self, chain: Chain | None) -> tuple[tuple[str, ...], tuple[Kind, ...]]:
        from mcpilco.recordings import joints_in, kinds_of

        if chain is not None:
            kinds = tuple(body.kind for body in chain.bodies)
            if self.joints is not None and kinds_of(self.joints) != kinds:
                raise InputError(
                    f"--joints says {self.joints}, {self.model} has {', '.join(kinds)}; leave "
                    "--joints out."
                )
            return chain.joints, kinds
        if self.joints is None:
            raise InputError("give --joints, as in --joints HHSH, or the robot's --model FILE.xml.")
        names, kinds = joints_in(self.recordings[0]), kinds_of(self.joints)
        if len(names) != len(kinds):
            raise InputError(
                f"--joints {self.joints} says {len(kinds)} joints, {self.recordings[0]} has "
                f"{len(names)}: {', '.join(names)}; give a letter for each."
            )
        return names, kinds

    def _write_report(self, model: Model, test: JointData, nmse: list[float]) -> None:
        from mcpilco.files import write_bytes

        told = {
            "kernel": self.kernel,
            "recordings": [str(path) for path in self.recordings],
            "hold_out": self.hold_out,
            "test_samples": len(test),
            "nmse": dict(zip(model.joints, nmse, strict=True)),
            "report": asdict(model.report),
        }
        write_bytes(self.out / "report.json", json.dumps(told, indent=1).encode())

    def _draw(self, model: Model, test: JointData) -> list[str]:
        """The file of the picture; a picture that cannot be drawn loses nothing else."""
        import torch

        from mcpilco.show.plots import new_axes, plot_torque, write_picture

        shown = test[:500]
        with torch.no_grad():
            tau = model(shown.motion).numpy()
            std = model.std(shown.motion)
        with options.without("torques.png"):
            axes = new_axes(len(model.joints))
            rows = zip(model.joints, _units(test), axes, strict=True)
            for j, (joint, unit, ax) in enumerate(rows):
                band = None if std is None else std[:, j].numpy()
                plot_torque(shown.tau[:, j], tau[:, j], joint, unit, band, ax)
            return [write_picture(self.out / "torques.png", axes[0]).name]
        return []


def _units(data: JointData) -> list[str]:
    return ["N m" if kind == "hinge" else "N" for kind in data.kinds]
