"""Learning as seen in a terminal: a row a trial, and bars for this trial and the whole run."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterator, Sequence

from rich.box import SIMPLE_HEAD
from rich.console import Console, Group
from rich.live import Live
from rich.measure import Measurement
from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn
from rich.progress import Progress as Bar
from rich.table import Table
from rich.text import Text

from mcpilco.data import Rollout, TrialResult, html_table, title_of
from mcpilco.logbook.callbacks import Agent, Callback

_REFRESH_HZ = 2.0  # drawing shares one core with the learning
_LARGE = 1e4
"""numbers from here on are shown with three digits and an exponent, in few columns"""


_CAPTION = "costs are sums over an episode"
_LIMITLESS = 10_000
_ALWAYS = ("trial", "experience [s]", "predicted cost", "real cost", "success", "wall [s]")
"""columns that stay where not all fit"""


def _number(value: float | None, digits: int) -> str:
    if value is None:
        return "-"
    return f"{value:.{digits}f}" if abs(value) < _LARGE else f"{value:.2e}"


def _row(result: TrialResult) -> dict[str, str]:
    return {
        "trial": str(result.trial),
        "experience [s]": _number(result.experience_s, 1),
        "predicted cost": _predicted(result),
        "real cost": _number(result.real_cost, 2),
        "success": {True: "yes", False: "no", None: "-"}[result.success],
        **{title_of(name): _number(value, 2) for name, value in result.outcome.items()},
        **_limits(result),
        "GP noise": " ".join(f"{std:.2g}" for std in result.noise_std) or "-",
        "wall [s]": _number(result.wall_s, 1),
    }


def _limits(result: TrialResult) -> dict[str, str]:
    if result.limits_crossed is None:
        return {}
    crossed = "crossed" if result.limits_crossed else "kept"
    kept = "-" if result.limits_kept is None else f"{100 * result.limits_kept:.1f}%"
    return {"limits": f"{kept} {crossed}"}


def _predicted(result: TrialResult) -> str:
    if math.isnan(result.predicted_cost):
        return "-"
    return f"{_number(result.predicted_cost, 2)} ± {_number(result.predicted_cost_std, 2)}"


class Results(list[TrialResult]):
    """The trials of a training, in order; a notebook shows them as a table."""

    def _repr_html_(self) -> str:
        return html_table([_row(result) for result in self])


class Progress(Callback):
    """A live table with a row a trial; below it bars for the fit, the policy and the whole run.

    Where the output is no terminal, one plain line a trial.
    """

    def __init__(self, console: Console | None = None) -> None:
        """Draws on `console`; by default on standard output."""
        self._console = console or Console()
        self._live: Live | None = None
        self._trials = 0
        self._trial = 0
        self._rows: list[dict[str, str]] = []

    def on_training_start(self, agent: Agent, trials: int) -> None:
        self.close()
        self._trials = getattr(agent, "trials", 0) + trials
        self._models = getattr(agent, "model", True) is not None
        self._rows = []
        self._bar = Bar(
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TimeRemainingColumn(),
            console=self._console,
            auto_refresh=False,
            speed_estimate_period=600.0,
        )
        done = self._trials - trials
        self._run = self._bar.add_task("whole run, trials", total=self._trials, completed=done)
        first = "exploring" if self._models else "learning"
        self._task = self._bar.add_task(first, total=None)
        if self._console.is_terminal:
            self._live = Live(
                Group(self._table, self._bar), console=self._console, refresh_per_second=_REFRESH_HZ
            )
            self._live.start(refresh=True)

    def on_exploration(self, rollout: Rollout) -> None:
        self._say(f"exploration: {len(rollout) * rollout.dt:.1f} s")

    def on_trial_start(self, trial: int) -> None:
        self._trial = trial
        # A fresh task, so that the time left is this trial's alone.
        self._bar.remove_task(self._task)
        doing = "fitting the models" if self._models else "learning"
        self._task = self._bar.add_task(f"{self._heading}: {doing}", total=None)

    def on_fit_step(self, step: int, steps: int) -> None:
        doing = f"{self._heading}: fitting the models"
        self._bar.update(self._task, completed=step, total=steps, description=doing)

    def on_model_fitted(self, values: dict[str, float]) -> None:
        if (fitted := values.get("model/fitted_samples")) is not None:
            through = values.get("model/inducing_points")
            some = f"from {values.get('model/posterior_samples', 0.0):.0f} of them"
            of = some if through is None else f"from all through {through:.0f} inducing points"
            self._console.print(
                f"trial {self._trial}: {values['model/samples']:.0f} samples are many: "
                f"hyperparameters from {fitted:.0f} of them, predictions {of}",
                highlight=False,
                soft_wrap=True,
            )

    def on_policy_step(self, step: int, steps: int, values: dict[str, float]) -> None:
        cost = values.get("policy/cost")
        doing = "searching the policy" if self._models else "learning"
        known = "" if cost is None else f", cost {cost:.2f}"
        self._bar.update(
            self._task, completed=step, total=steps, description=f"{self._heading}: {doing}{known}"
        )
        self._bar.update(self._run, completed=self._trial - 1 + step / max(steps, step, 1))

    def on_trial_end(self, result: TrialResult) -> None:
        self._rows.append(_row(result))
        self._bar.update(self._run, completed=result.trial)
        if self._live is not None:
            self._live.update(Group(self._table, self._bar))
        self._say(", ".join(f"{name} {value}" for name, value in self._rows[-1].items()))

    def on_training_end(self) -> None:
        self.close()

    def close(self) -> None:
        """Leaves the table on the screen, without the bar, and gives the terminal back."""
        if self._live is not None:
            self._live.update(self._table, refresh=True)
            self._live.stop()
            self._live = None

    @property
    def _table(self) -> Table:
        """The rows so far, under the columns that any of them has and that fit whole."""
        widest = max(self._rows, key=len, default={})
        columns, caption = list(widest), _CAPTION
        while True:
            table = self._with(columns, caption)
            wide = self._console.options.update(width=_LIMITLESS)
            told = [name for name in columns if name not in _ALWAYS]
            if Measurement.get(self._console, wide, table).maximum <= self._console.width:
                return table
            if not told:
                return table
            columns.remove(told[-1])
            caption = f"{_CAPTION}; more is in metrics.csv"

    def _with(self, columns: Sequence[str], caption: str) -> Table:
        """The table of some columns; a word a line, for numbers to stay whole in 80 columns."""
        table = Table(box=SIMPLE_HEAD, caption=caption, padding=(0, 0, 0, 1), pad_edge=False)
        for name in columns:
            # As Text, for a unit is no markup.
            heading = Text(name.replace(" ", "\n"))
            table.add_column(heading, justify="right", vertical="bottom", no_wrap=True)
        for row in self._rows:
            cells = (row.get(name, "-").replace("± ", "±") for name in columns)
            table.add_row(*(cell.replace(" ", "\n") for cell in cells))
        return table

    @property
    def _heading(self) -> str:
        return f"trial {self._trial} of {self._trials}"

    def _say(self, line: str) -> None:
        if not self._console.is_terminal:
            self._console.print(line, markup=False, highlight=False, soft_wrap=True)


@contextlib.contextmanager
def counting(
    what: str, total: int, done: int = 0, quiet: bool = False, speed_period_s: float = 600.0
) -> Iterator[Callable[[str], None]]:
    """A function that prints a line for each that ends, above a bar on a terminal."""
    console = Console(quiet=quiet)
    columns = TextColumn(what), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn()
    hidden = quiet or not console.is_terminal
    if done:
        console.print(f"{done} of {total} {what} are there already.", highlight=False)
    with Bar(
        *columns, console=console, speed_estimate_period=speed_period_s, disable=hidden
    ) as bar:
        task = bar.add_task(what, total=total, completed=done)

        def show(line: str) -> None:
            bar.console.print(line, markup=False, highlight=False, soft_wrap=True)
            bar.advance(task)

        yield show
