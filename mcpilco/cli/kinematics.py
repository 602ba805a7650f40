"""`mcpilco kinematics`: a robot's chain and its forward kinematics from a camera."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from mcpilco.cli.options import Command, optional, use_one_thread, warn, without
from mcpilco.typing import InputError

if TYPE_CHECKING:
    from mcpilco.identification.kinematics import ForwardKinematics, KinematicChain, PoseErrors
    from mcpilco.recordings import MarkerRecording


@dataclass(frozen=True)
class Kinematics(Command):
    """Find a robot's kinematic chain in marker poses, and learn its forward kinematics."""

    files: Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="FILE...")]
    """CSV, npz, mat or parquet of `time`, joints and marker poses, or two: poses, and joints"""
    out: Annotated[Path | None, optional("FOLDER", "nothing is written")] = None
    """folder for kinematics.json, kinematics.xml, forward.npz and kinematics.png"""
    gravity: tuple[float, float, float] = (0.0, 0.0, -9.81)
    """in the camera's frame [m/s^2]: of kinematics.xml, whose masses are placeholders"""
    position_tolerance: float = 0.02
    """largest residual of positions in a test: some five times their noise [m]"""
    orientation_tolerance: float = 0.1
    """largest residual of orientations [rad]"""
    outliers: float = 0.2
    """share of the poses of two markers that may be wrong [-]"""
    samples: int = 300
    """from which the forward kinematics is learned; the others test it"""
    seed: int = 0
    """of the draw of these samples"""

    def __call__(self) -> int:
        use_one_thread()
        from mcpilco.identification import kinematics
        from mcpilco.recordings import read_markers

        if not 1 <= len(self.files) <= 2:
            raise InputError(
                f"expected one file, or one of poses and one of joints, got {len(self.files)}."
            )
        tolerance = kinematics.Tolerance(
            self.position_tolerance, self.orientation_tolerance, self.outliers
        )
        recording, remarks = read_markers(*self.files)
        warn(*remarks, about="mcpilco: note")
        chain = kinematics.find_chain(recording, tolerance)
        _print_chain(chain)
        model = kinematics.fit_forward(recording, chain, self.samples, seed=self.seed)
        errors = kinematics.prediction_errors(model, recording)
        _print_forward(model, errors)
        warn(*chain.report.warnings, *model.report.warnings, about="mcpilco: note")
        if self.out is not None:
            self._write(recording, chain, model, errors, tolerance)
        return 0

    def _write(
        self,
        recording: MarkerRecording,
        chain: KinematicChain,
        model: ForwardKinematics,
        errors: PoseErrors | None,
        tolerance: Any,
    ) -> None:
        from mcpilco.files import make_folder, write_bytes
        from mcpilco.show.plots import draw_kinematics

        assert self.out is not None
        make_folder(self.out, "kinematics.json", "kinematics.xml", "forward.npz", "kinematics.png")
        told = {
            "base": chain.base,
            "joints": [asdict(joint) for joint in chain.joints],
            "tolerance": asdict(tolerance),
            "chain": asdict(chain.report),
            "forward": {
                "marker": model.marker,
                "samples": len(model.q),
                "errors": None if errors is None else errors.summary(),
                **asdict(model.report),
            },
        }
        write_bytes(self.out / "kinematics.json", json.dumps(told, indent=1).encode())
        xml = self._mjcf(recording, chain, tolerance)
        write_bytes(self.out / "kinematics.xml", xml.encode())
        forward = model.save(self.out / "forward.npz").name
        written = ["kinematics.json", "kinematics.xml", forward]
        with without("kinematics.png"):
            draw_kinematics(self.out / "kinematics.png", recording, chain, errors, tolerance)
            written.append("kinematics.png")
        print(f"In {self.out}: {', '.join(written)}.")

    def _mjcf(self, recording: MarkerRecording, chain: KinematicChain, tolerance: Any) -> str:
        """The chain as a model: a motor for each joint, called as its measured force."""
        from mcpilco.bodies import SLIDE
        from mcpilco.identification.kinematics import chain_in_space
        from mcpilco.mjcf import mjcf_of

        found = chain_in_space(recording, chain, self.gravity, tolerance)
        forces = ("force" if body.kind == SLIDE else "torque" for body in found.bodies)
        names = (f"{joint}_{force}" for joint, force in zip(found.joints, forces, strict=True))
        return mjcf_of(found, [(name, j, 1.0) for j, name in enumerate(names)])


def _print_chain(chain: KinematicChain) -> None:
    from mcpilco.bodies import HINGE

    print(f"base  marker {chain.base}")
    for joint in chain.joints:
        kind = "turns" if joint.kind == HINGE else "slides"
        print(
            f"      joint {joint.name} {kind}, then marker {joint.marker}; "
            f"residuals {1e3 * joint.position_residual:.2g} mm, "
            f"{joint.orientation_residual:.2g} rad"
        )


def _print_forward(model: ForwardKinematics, errors: PoseErrors | None) -> None:
    print(f"forward kinematics of {model.marker}, from {len(model.q)} samples")
    if errors is None:
        print("      not tested: no sample is left; ask for fewer with --samples")
        return
    x, y, z = (1e3 * errors.position_median).tolist()
    print(
        f"      on {len(errors.time)} other samples: median error {x:.2g}, {y:.2g}, {z:.2g} mm in "
        f"x, y, z, {errors.angle_median:.2g} rad; the noise of the poses is part of it"
    )
