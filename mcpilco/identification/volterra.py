"""Volterra series from recordings: an output as a polynomial of past inputs.

`fit_volterra` makes a `VolterraModel` from a `mcpilco.recordings.Series` and a `VolterraConfig`;
`save_volterra` and `load_volterra` keep it as a file of plain arrays.

Reference: thesis chapter 6.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from mcpilco.config import from_dict
from mcpilco.files import damaged, read_groups, write_groups
from mcpilco.gp import GP, Posterior, WeightPosterior, WeightSpaceGP
from mcpilco.identification.report import Report, jitter_of
from mcpilco.kernels import IPK, PK, SEDMPK, MonomialBasis, VolterraKernel, VolterraMPK, symmetric
from mcpilco.recordings import Series, lagged, suspicions, usable
from mcpilco.typing import InputError, McPilcoError

KERNELS: Mapping[str, Callable[..., VolterraKernel]] = {
    "pk": PK,
    "ipk": IPK,
    "mpk": VolterraMPK,
    "sed-mpk": SEDMPK,
    "sed-mpk-hierarchical": partial(SEDMPK, hierarchical=True),
}
"""priors by name: of width, degree and batch, and SEDMPK of channels"""

MANY_ORDERS = 10**6
"""entries of a covariance over all orders of the lags, beyond which it is not written out"""


@dataclass(frozen=True)
class VolterraConfig:
    """The series, its prior, and how it is fitted."""

    lags: int = 20
    """m: outputs depend on the inputs of so many samples before, and of now"""
    degree: int = 3
    """r: of the polynomials"""
    kernel: str = "sed-mpk"
    """a key of `KERNELS`"""
    center: bool = False
    """develop the series about the inputs' means, in place of zero"""
    noise_floor: float = 1e-3
    """least standard deviation of the noise, in parts of the output's root mean square [-]"""
    fit_samples: int = 1000
    """as many samples, drawn at random, determine the hyperparameters; the evidence is theirs"""
    samples: int = 4000
    """as many determine the series where matrices of the monomials would be larger"""
    restarts: int = 0
    """further starts of the optimiser"""
    max_iterations: int = 500
    """of each start"""
    tolerance: float = 1e-7
    """stop once a step improves the evidence by less than this part of it [-]"""
    seed: int = 0
    """of what is drawn"""

    def __post_init__(self) -> None:
        if self.kernel not in KERNELS:
            raise InputError(f"kernel must be one of {', '.join(KERNELS)}, got {self.kernel!r}.")
        for name, least in (("lags", 0), ("degree", 1), ("fit_samples", 1), ("samples", 1)):
            if getattr(self, name) < least:
                raise InputError(f"{name} must be at least {least}, got {getattr(self, name)}.")
        if not 0.0 < self.noise_floor < 1.0:
            raise InputError(f"noise_floor must lie between 0 and 1, got {self.noise_floor}.")


def prior(config: VolterraConfig, outputs: Sequence[str], channels: int, samples: int) -> GP:
    """A GP of the config's kernel, in weight space where that is the smaller one."""
    width = channels * (config.lags + 1)
    full = config.kernel.startswith("sed-mpk")
    each = {"channels": channels} if full else {}
    kernel = KERNELS[config.kernel](width, config.degree, (len(outputs),), **each)
    orders = width ** (config.degree * (2 if full else 1))
    features = MonomialBasis.size(width, config.degree)
    small = features < min(samples, config.fit_samples) and orders <= MANY_ORDERS
    kind = WeightSpaceGP if small else GP
    return kind(kernel, noise_floor=config.noise_floor, names=outputs)


_CHUNK = 1000
"""rows that are predicted together"""


@dataclass(frozen=True)
class Scaling:
    """Units of the GP's numbers: centred inputs of deviation 1, outputs of mean square 1."""

    center: Float[np.ndarray, " U"]
    """of the inputs, in their units"""
    inputs: Float[np.ndarray, " U"]
    """one of the GP's inputs is so much"""
    outputs: Float[np.ndarray, " E"]

    @classmethod
    def of(cls, series: Series, center: bool) -> Scaling:
        """Inputs become of standard deviation 1, outputs of mean square 1."""
        means = np.nanmean(series.inputs, 0) if center else np.zeros(series.inputs.shape[1])
        sizes = np.sqrt(np.nanmean((series.inputs - means) ** 2, 0))
        return cls(means, sizes, np.sqrt(np.nanmean(series.outputs**2, 0)))


@dataclass(frozen=True, eq=False)
class VolterraModel:
    """Volterra series of E outputs, with what is uncertain of them."""

    config: VolterraConfig
    input_names: tuple[str, ...]
    output_names: tuple[str, ...]
    scaling: Scaling
    gp: GP
    """prior and noise, in scaled numbers"""
    X: Float[Tensor, "N D"]
    """regressors of the samples that determine the series, scaled"""
    Y: Float[Tensor, "N E"]
    """their outputs, scaled"""
    posterior: Posterior | WeightPosterior
    """of X and Y"""
    report: Report

    @property
    def noise_std(self) -> Float[np.ndarray, " E"]:
        """Standard deviation of the noise, in the unit of each output."""
        return self.gp.noise_std.detach().numpy() * self.scaling.outputs

    def predict(
        self, inputs: Float[np.ndarray, "T U"] | Float[np.ndarray, " T"]
    ) -> tuple[Float[np.ndarray, "T E"], Float[np.ndarray, "T E"]]:
        """Mean and standard deviation of the outputs without noise; NaN where a lag is missing.

        Inputs are of consecutive times; the first `lags` rows have no prediction.

        Raises:
            InputError: they have not as many columns as those that the model was fitted to.
        """
        inputs = np.asarray(inputs, dtype=float)
        inputs = inputs[:, None] if inputs.ndim == 1 else inputs
        if inputs.ndim != 2 or inputs.shape[1] != len(self.input_names):
            raise InputError(
                f"The model has the inputs {', '.join(self.input_names)}: expected shape "
                f"(T, {len(self.input_names)}), got {inputs.shape}."
            )
        found = np.full((2, len(inputs), len(self.output_names)), np.nan)
        if len(inputs) <= self.config.lags:
            return found[0], found[1]
        X = lagged((inputs - self.scaling.center) / self.scaling.inputs, self.config.lags)
        known = np.flatnonzero(np.isfinite(X).all(1))
        for rows in np.split(known, range(_CHUNK, len(known), _CHUNK)):
            mean, variance = self.posterior.mean_and_variance(torch.as_tensor(X[rows]))
            found[0, rows + self.config.lags] = mean.numpy()
            found[1, rows + self.config.lags] = variance.sqrt().numpy()
        return found[0] * self.scaling.outputs, found[1] * self.scaling.outputs

    @torch.no_grad()
    def coefficients(self, degree: int) -> Float[np.ndarray, "E ..."]:
        """h_i: for each output an axis for each lag, symmetric; of several inputs as in `lagged`.

        Of centred inputs it is the map of what they differ from their means.

        The shape is (E,) for degree 0, (E, D) for 1, (E, D, D) for 2, ...

        Raises:
            InputError: the series has no such map, or it has too many entries to write down.
        """
        self._require(degree)
        # K^-1 y, of the residuals: they are what the noise explains
        residuals = self.Y - self.posterior.mean_and_variance(self.X)[0]
        alpha = (residuals / self.gp.noise_std.square()).mT
        kernel: VolterraKernel = self.gp.kernel  # type: ignore[assignment]
        if degree == 0:
            h = kernel.offset_variance() * alpha.sum(-1)
        else:
            scale, metrics = kernel.maps()[degree - 1]
            *others, last = (kernel.times(self.X, S) for S in metrics)
            terms = alpha[..., None]
            for factor in others:
                terms = (terms[..., None] * factor[..., None, :]).flatten(-2)
            h = scale[:, None, None] * (terms.mT @ last)
            h = symmetric(h.reshape(len(h), *[kernel.width] * degree), degree)
        return self._in_units(h.numpy(), degree)

    @torch.no_grad()
    def penalties(self, degree: int) -> Float[np.ndarray, "E ..."]:
        """lambda_h of h_i in scaled numbers, axes as of `coefficients`; what is small is penalised.

        Raises:
            InputError: as `coefficients`.

        Reference: thesis eq. (6.37), figure 6.2.
        """
        self._require(degree, least=1)
        kernel: VolterraKernel = self.gp.kernel  # type: ignore[assignment]
        return kernel.penalties(degree).numpy()

    def _require(self, degree: int, least: int = 0) -> None:
        if not least <= degree <= self.config.degree:
            raise InputError(
                f"degree must be within {least}..{self.config.degree}, as the series, got {degree}."
            )
        if self.gp.kernel.width**degree > MANY_ORDERS:
            raise InputError(
                f"h_{degree} has {self.gp.kernel.width}^{degree} entries, more than "
                f"{MANY_ORDERS}; ask for a map of lower degree, or fit fewer lags."
            )

    def _in_units(self, h: np.ndarray, degree: int) -> np.ndarray:
        each = 1.0 / np.repeat(self.scaling.inputs, self.config.lags + 1)
        for axis in range(1, degree + 1):
            h = h * each.reshape(-1, *[1] * (degree - axis))
        return h * self.scaling.outputs.reshape(-1, *[1] * degree)


def fit_volterra(
    series: Series, config: VolterraConfig | None = None, gp: GP | None = None
) -> VolterraModel:
    """The series that explains the outputs, with the hyperparameters of the highest evidence.

    A `gp` of scaled numbers replaces the config's prior; its kernel is a `VolterraKernel`.

    Raises:
        InputError: there are too few samples, or an input or output stands still.
        NotPositiveDefiniteError: a covariance matrix has no Cholesky factor.
    """
    config = config or VolterraConfig()
    X, Y = usable(series, config.lags)
    scaling = Scaling.of(series, config.center)
    repeats = config.lags + 1
    X = (X - np.repeat(scaling.center, repeats)) / np.repeat(scaling.inputs, repeats)
    Y = Y / scaling.outputs
    gp = gp or prior(config, series.output_names, len(series.input_names), len(X))
    order = np.random.default_rng(config.seed).permutation(len(X))
    most = len(X) if isinstance(gp, WeightSpaceGP) else config.samples
    fitted, used = np.sort(order[: config.fit_samples]), np.sort(order[:most])
    gp.fit(
        torch.as_tensor(X[fitted]),
        torch.as_tensor(Y[fitted]),
        restarts=config.restarts,
        max_iterations=config.max_iterations,
        tolerance=config.tolerance,
        seed=config.seed,
    )
    posterior = gp.condition(torch.as_tensor(X[used]), torch.as_tensor(Y[used]))
    return VolterraModel(
        config=config,
        input_names=series.input_names,
        output_names=series.output_names,
        scaling=scaling,
        gp=gp,
        X=torch.as_tensor(X[used]),
        Y=torch.as_tensor(Y[used]),
        posterior=posterior,
        report=_report(gp, posterior, series, config, scaling, len(fitted)),
    )


def _report(
    gp: GP,
    posterior: Posterior | WeightPosterior,
    series: Series,
    config: VolterraConfig,
    scaling: Scaling,
    fitted: int,
) -> Report:
    assert gp.report is not None
    unidentified, warnings = suspicions(series, config.lags, config.degree, config.center)
    if not gp.report.converged:
        warnings += (
            f"The optimiser stopped after {gp.report.iterations} iterations before it converged; "
            "raise max_iterations.",
        )
    return Report(
        converged=gp.report.converged,
        iterations=gp.report.iterations,
        evidence=tuple((-np.array(gp.report.nlml) - fitted * np.log(scaling.outputs)).tolist()),
        jitter=jitter_of(posterior) if isinstance(posterior, Posterior) else (0.0,) * gp.outputs,
        unidentified=unidentified,
        warnings=warnings,
    )


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
        if about["format"] != FORMAT:
            raise ValueError(f"format {about['format']!r}, expected {FORMAT}")
        config = VolterraConfig(**about["config"])
        inputs, outputs = tuple(about["input_names"]), tuple(about["output_names"])
        X, Y = (torch.as_tensor(np.asarray(groups["samples"][key], dtype=float)) for key in "XY")
        gp = prior(config, outputs, len(inputs), len(X))
        gp.load_arrays(groups["prior"])
        scaling, report = Scaling(**groups["scaling"]), from_dict(Report, about["report"])
        posterior = gp.condition(X, Y)
        return VolterraModel(config, inputs, outputs, scaling, gp, X, Y, posterior, report)
    except (KeyError, TypeError, ValueError, AttributeError, McPilcoError) as error:
        raise damaged(Path(path), f"no Volterra model: {error}") from error


def fit_percent(z: Float[np.ndarray, " N"], predicted: Float[np.ndarray, " N"]) -> float:
    """100 (1 - |z - predicted|_1 / |z - mean z|_1) [%]: 100 is perfect, 0 as good as the mean.

    Pairs with a NaN are left out.

    Reference: thesis section 6.5.1.
    """
    known = np.isfinite(z) & np.isfinite(predicted)
    z, predicted = z[known], predicted[known]
    return float(100.0 * (1.0 - np.abs(z - predicted).sum() / np.abs(z - z.mean()).sum()))
