"""`mcpilco volterra`: the Volterra series from the inputs to the outputs of a recording."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from mcpilco.cli.options import Command, optional, use_one_thread, warn, without
from mcpilco.typing import InputError

if TYPE_CHECKING:
    import numpy as np

    from mcpilco.identification import VolterraModel
    from mcpilco.recordings import Series

_SHOWN = 300
"""samples of the test that are drawn"""


@dataclass(frozen=True)
class Volterra(Command):
    """Find the Volterra series from inputs to outputs, and say how well it predicts."""

    recording: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="FILE")]
    """CSV, npz, mat or parquet: a column for each input and output, a row a sample"""
    inputs: Annotated[tuple[str, ...], tyro.conf.arg(metavar="COLUMN...")]
    """what was commanded"""
    outputs: Annotated[tuple[str, ...], tyro.conf.arg(metavar="COLUMN...")]
    """what was measured"""
    out: Annotated[Path, tyro.conf.arg(metavar="FOLDER")]
    """folder for model.npz, prediction.csv and volterra.png"""
    lags: int = 20
    """memory: outputs depend on the inputs of so many samples before [samples]"""
    degree: int = 3
    """of the polynomials"""
    kernel: Annotated[tuple[str, ...], tyro.conf.arg(metavar="KERNEL...")] = ("sed-mpk",)
    """pk, ipk, mpk, sed-mpk, sed-mpk-hierarchical; of several that with the highest evidence"""
    test: Annotated[Path | None, optional("FILE", "the last rows of the recording")] = None
    """another recording with these columns, on which the series is judged"""
    held_out: float = 0.3
    """part of the recording, its end, that is not fitted to without --test [-]"""
    center: bool = False
    """develop the series about the inputs' means, in place of zero"""
    restarts: int = 0
    """further starts of the optimiser"""
    seed: int = 0
    """of what is drawn"""

    def __call__(self) -> int:
        use_one_thread()
        from mcpilco.files import make_folder
        from mcpilco.identification import save_volterra

        train, test = self._data()
        model = self._best(train, test)
        warn(*model.report.warnings, about="mcpilco: warning")
        make_folder(self.out, "model.npz", "prediction.csv", "volterra.png")
        mean, std = model.predict(test.inputs)
        save_volterra(model, self.out / "model.npz")
        _write_prediction(self.out / "prediction.csv", model, test, mean, std)
        written = ["model.npz", "prediction.csv"]
        with without("a picture"):
            _picture(self.out / "volterra.png", model, test, mean, std)
            written.append("volterra.png")
        print(f"In {self.out}: {', '.join(written)}.")
        return 0

    def _data(self) -> tuple[Series, Series]:
        from mcpilco.recordings import read_series

        if not self.inputs or not self.outputs:
            raise InputError("--inputs and --outputs must name at least one column each.")
        if not self.kernel:
            raise InputError("--kernel must name at least one kernel.")
        series = read_series(self.recording, self.inputs, self.outputs)
        warn(*series.remarks, about="mcpilco: warning")
        if self.test is not None:
            test = read_series(self.test, self.inputs, self.outputs)
            warn(*test.remarks, about="mcpilco: warning")
            return series, test
        if not 0.0 < self.held_out < 1.0:
            raise InputError(f"--held-out must lie between 0 and 1, got {self.held_out}.")
        last = len(series) - round(self.held_out * len(series))
        if len(series) - last <= self.lags:
            raise InputError(
                f"--held-out leaves {len(series) - last} of {len(series)} rows to judge on, and "
                f"the first {self.lags} have no prediction; record for longer, or give --test."
            )
        return series[:last], series[last:]

    def _best(self, train: Series, test: Series) -> VolterraModel:
        """Of the fits with each kernel, all of which are told, that with the highest evidence."""
        from mcpilco.identification import VolterraConfig, fit_volterra

        names = ("lags", "degree", "center", "restarts", "seed")
        numbers: dict[str, Any] = {name: getattr(self, name) for name in names}
        models = []
        for kernel in self.kernel:
            models.append(fit_volterra(train, VolterraConfig(kernel=kernel, **numbers)))
            _tell(models[-1], train, test)
        best = max(models, key=lambda model: sum(model.report.evidence))
        if len(models) > 1:
            print(f"Highest evidence: {best.config.kernel}")
        return best


def _tell(model: VolterraModel, train: Series, test: Series) -> None:
    from mcpilco.identification import fit_percent

    fitted, judged = model.predict(train.inputs)[0], model.predict(test.inputs)[0]
    for e, name in enumerate(model.output_names):
        print(
            f"{model.config.kernel}, {name}: "
            f"Fit {fit_percent(test.outputs[:, e], judged[:, e]):.1f} % on {len(test)} samples "
            f"not seen, {fit_percent(train.outputs[:, e], fitted[:, e]):.1f} % on those fitted; "
            f"noise {model.noise_std[e]:.4g}; log evidence {model.report.evidence[e]:.1f}"
        )


def _write_prediction(
    path: Path, model: VolterraModel, test: Series, mean: np.ndarray, std: np.ndarray
) -> None:
    """Measured and predicted outputs, and the predictions' standard deviations with the noise."""
    import numpy as np

    from mcpilco.files import csv_bytes, write_bytes

    columns: dict[str, np.ndarray] = {"sample": np.arange(len(test))}
    for e, name in enumerate(model.output_names):
        columns[name] = test.outputs[:, e]
        columns[f"{name}_predicted"] = mean[:, e]
        columns[f"{name}_std"] = np.hypot(std[:, e], model.noise_std[e])
    cells = ([f"{value:.10g}" for value in column] for column in columns.values())
    content = csv_bytes(list(columns), zip(*cells, strict=True))
    write_bytes(path, content.replace(b"nan", b""))


def _picture(
    path: Path, model: VolterraModel, test: Series, mean: np.ndarray, std: np.ndarray
) -> None:
    import numpy as np

    import mcpilco.show.plots as plots

    one = slice(0, model.config.lags + 1)
    rows = slice(model.config.lags, model.config.lags + _SHOWN)
    axes = plots.new_axes(4 if model.config.degree > 1 else 2)
    noisy = np.hypot(std, model.noise_std)
    name = model.output_names[0]
    plots.plot_prediction(test.outputs[rows, 0], mean[rows, 0], noisy[rows, 0], name, axes[0])
    plots.plot_response(model.coefficients(1)[0, one], ax=axes[1])
    if model.config.degree > 1:
        plots.plot_lags(model.coefficients(2)[0, one, one], "|h_2|", axes[2])
        plots.plot_lags(model.penalties(2)[0, one, one], "its prior variance", axes[3])
    plots.write_picture(path, axes[0])
