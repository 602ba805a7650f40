"""Every threshold by which `gap` decides, on one page.

Thresholds that decide together are one frozen dataclass; [units] stand in brackets, and misfits are
squared residuals over the noise variance. A number was chosen by hand where its docstring gives no
source. `runs/hidden_effects` shows how often all of them together come to the right verdict.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class DataThresholds:
    """How recordings are cut into windows, and what is assumed of plant and noise."""

    window_s: float = 1.06
    """length of a window [s]: an effect shows far above the noise, and no pole has diverged yet"""
    shortest_s: float = 0.26
    """the same where a motion does not answer smoothly to its start for longer [s]"""
    bent: float = 0.1
    """part of an answer to a start that is out of proportion, up to which it is smooth [-]"""
    past_s: float = 0.4
    """of commands that a recording must have before a window [s]: lags and delays answer to them"""
    memory_s: float = 3.0
    """of commands before a window where a recording has them [s]: backlash remembers a turn"""
    shortest_hold_s: float = 5e-3
    """for which a simulated command is held, at least [s]: a joint then moves far below a count"""
    compared_s: float = 0.01
    """between samples that are compared, where a log has more [s]: one between tells nothing"""
    latency_s: float = 0.06
    """at the start of a window that is not compared [s]: a sensor that lags sees what was before"""
    least_measured: float = 0.8
    """part of the positions that a window must have [-]"""
    fewest_windows: int = 6
    """windows without which nothing is named: the verdict is `too_poor`"""
    searched_windows: int = 28
    """windows that a search looks at, of all recordings, for its cost; the last fit has all"""
    costly_windows: int = 14
    """the same of a costly plant; more where they are short"""
    most_of_short: float = 3.0
    """times as many of these where they are short, at most [-]"""
    held_out: float = 0.42
    """most of the samples that are held out [-]"""
    fewest_to_split: int = 3
    """recordings below which none is held out"""
    held_out_every_s: float = 0.3
    """between the starts of two held-out windows, which overlap [s]"""
    later_s: float = 0.5
    """by which recordings begin later for `--stability` [s]: all windows are then others"""
    uncertainty: float = 0.01
    """prior std of masses, lengths, base friction and gains over their values [-]; an option"""
    least_noise: float = 1e-4
    """least noise std over the std of a state's values [-]: integrators differ by as much"""
    told_every: int = 2
    """one of so many windows decides when commands went out and in what steps, for its cost"""
    told_iterations: int = 5
    """of the fit that decides this"""
    told_errors: float = 2.0
    """standard errors by which recordings must fit better that are told otherwise [-]"""


@dataclass(frozen=True)
class BudgetThresholds:
    """Integrator steps that may be taken, so that equal data lead to equal results."""

    steps: float = 6.5e7
    """of an investigation: about a minute on one core"""
    costly: float = 5.0
    """times as many where MuJoCo simulates [-]: some minutes on one core"""
    stage_steps: float = 1.5e7
    """left at least for a search anew, twins of effects, and last fits; see `rough` 2391. Besides,
    to learn a force"""
    usual_dt_s: float = 0.02
    """time for which a command is held from which on this is so [s]: each takes a step at least"""
    fit: float = 0.2
    """part of the steps left beyond which a fit makes no further iteration [-]"""
    search: float = 0.7
    """part of the steps left for the search, and once more where it ends too soon [-]"""
    bursts: float = 0.5
    """part of the steps left to find bursts of force [-]"""
    learning: float = 0.6
    """part of the steps left to find the parts of a learned force; the rest is for its fit [-]"""


@dataclass(frozen=True)
class FitThresholds:
    """When a fit ends, how far it may step, and which windows lead it."""

    converged: float = 1e-4
    """relative change of the cost below which a fit ends [-]"""
    crawl: float = 0.02
    """relative change of the cost below which a hasty fit ends [-]"""
    settled: float = 1.0
    """change of the cost below which a dear fit ends [misfit of a sample]; a name needs 15"""
    tolerated: float = 9.0
    """times the median misfit up to which a window counts in full [-]: three standard deviations"""
    foretold: float = 0.75
    """part of the hoped fall of a cost from which on the linear form that hoped so is kept [-]"""
    few: int = 4
    """steps of initial states that follow a change of theta"""
    divergence: float = 20.0
    """growth of a start state's error beyond which a window is cut off [-]: no fit can follow it"""
    free_std: float = 1.0
    """relative prior std of a freed parameter [-]: its order of magnitude is meant"""
    free_force_std: float = 10.0
    """the same of a force in a joint that is found to differ [-]: the nominal one may be small"""
    farthest: float = 2.5
    """factor by which one step may change a mass, or what enters as a logarithm [-]"""
    nothing: float = 0.1
    """part of the size that a probe has below which a parameter is no start for an effect [-]"""
    least_scale: float = 0.1
    """sensor scale below which a reading is not inverted [-]"""
    quickest_s: float = 1e-4
    """in which dry friction may bring its joint to rest [s]: what a simulation can follow"""
    quick_s: float = 1e-3
    """the same where none could tell it from a quicker one [s]; `rough` 2327 is worse by 3e-3"""
    unseen_turn: float = 0.003
    """part of its joint's usual speed up to which none could tell where it turns over [-]"""


@dataclass(frozen=True)
class DisturbanceThresholds:
    """The random force in each joint."""

    ratios: tuple[float, float] = (-25.0, 12.0)
    """log of its variance over the noise's [(usual force / noise std)^2]: none, and far too much"""
    most: float = 0.3
    """random force that weighs a fit at most [usual forces]: more would fit it to nothing"""
    least: float = 0.001
    """random force below which it is not asked whether it is there [usual forces]"""
    least_noise: float = 0.1
    """noise of a reading, at least [reported noise]: smaller is rounding"""
    converged: float = 0.05
    """slope of the deviance over asinh(std) that counts as none [-]: then it is right to 1e-3"""
    farthest: float = 4.0
    """by which asinh(std) may change at once [-]"""
    usual: float = -9.0
    """log of its variance over that of the noise from which its size is sought [-]"""
    begun: float = 0.05
    """asinh(std) from which it is, at least [-]: at none the deviance is always level"""
    turns: int = 5
    """in which the noise of each reading and its correlation are estimated, at most"""
    same_noise: float = 0.05
    """change of its log or correlation below which a turn is the last"""
    most_correlated: float = 0.6
    """of noise with that of the sample before, at most [-]: more is what a force does"""
    least_freedom: float = 10.0
    """readings beyond what forces and initial states explain, with which it is estimated"""


@dataclass(frozen=True)
class ScreenThresholds:
    """How the effects are scored that a fit lacks."""

    many_probes: int = 10
    """probes of an effect beyond which it is scored on a part of the windows, for its cost"""
    thinned: int = 3
    """then one of so many windows counts"""
    checked: int = 24
    """effects that are simulated on all windows where that is dear, of those that promise most"""
    influence: float = 10.0
    """times the influence at three quarters of the windows that a change may have in one [-]"""
    farthest: float = 500.0
    """change beyond which a simulation ran away, unless all motions range further [noise std]"""
    separable: float = 1e-6
    """least part of a signature that no fitted parameter makes [-]: less is rounding"""
    rounding: float = 1e-12
    """part by which a fitted parameter differs at least from all that others do [-]"""


@dataclass(frozen=True)
class SearchThresholds:
    """When an effect is tried, added, carried on or dropped."""

    promising: float = 25.0
    """least fall of chi^2 by the linear response for which an effect is fitted [noise variances]"""
    bic_gain: float = 15.0
    """least gain in BIC that adds an effect; 10 is very strong (Kass & Raftery, JASA 90, 1995)"""
    prior_gain: float = 1.0
    """the same by the prior alone: errors of 1 to 3 % pull it by 3 at most, masses and gains that
    are 10 % off by 10 to 13, of which a name costs 9 (rough seeds)"""
    strained: float = 10.0
    """-2 log prior of a fit beyond which effects of masses that promise as much are fitted [-]"""
    relieving: int = 2
    """of these that are fitted, for the cost"""
    same_bic: float = 0.01
    """difference in BIC below which models do the same: rounding"""
    least_force: float = 0.01
    """random force in a joint below which nothing is left [usual forces]; `rough` leaves 0.008"""
    least_noise: float = 2.0
    """variance of the noise beyond the reported one that an effect may explain [-]; where it is
    correlated its std is reported too small, by a factor of 1.3 to 2.1 in tier `rough`"""
    shortlist: int = 6
    """effects that are tried on a model, for the cost"""
    thinned: int = 2
    """they are fitted to one of so many windows, for the cost"""
    refined: int = 4
    """of these that are fitted to all windows, for the cost"""
    part_of_exchanged: float = 0.1
    """least part of what an effect explains that one must promise to be tried in its place [-]"""
    as_much: float = 0.5
    """part of what one effect explains that one in its place, or beside it, must promise [-]"""
    exchanges: int = 3
    """effects that are tried in the place of one, besides its special and general cases"""
    beam: int = 3
    """models beside the best whose neighbours are tried, for the cost"""
    followed: int = 12
    """models that are judged anew with the random forces of a better one, for the cost"""
    patience: int = 1
    """rounds that a search goes on without a better model"""
    begun: tuple[float, ...] = (4.0, 1.0, 0.25, 0.0625)
    """parts of the size by the linear response that are tried [-]: it errs where joints stick"""
    resized: tuple[float, ...] = (2.0, 0.5, 1.41, 0.71, 1.19, 0.84)
    """times the size that a fit ends at which are tried where a simulation is dear: the first for
    each, all for the best model [-]"""
    starts: int = 2
    """of these, the best, from which an effect is fitted: a joint that sticks has several optima"""
    most_effects: int = 7
    """in a model, at most: each velocity that a rig filters is one already"""
    parts: int = 4
    """of a window, which are searched where the best model of whole windows misses much"""
    least_compared: int = 3
    """samples that are compared in each of these, at least: two tell no more than how it starts"""
    hints: int = 4
    """models of these that are fitted to whole windows"""


@dataclass(frozen=True)
class EventThresholds:
    """Events, which no model explains: samples read wrongly, pushes, contacts."""

    spike: float = 8.0
    """noise std by which a sample that was read wrongly stands out from its neighbours"""
    beyond: float = 4.0
    """times the range of its four neighbours by which it does so too [-]: of noise about 2 std"""
    far: float = 12.0
    """times the median misfit from which a window may hold an event [-]"""
    rare: float = 0.35
    """part of the windows beyond which what is missed is no event but the model is wrong [-]"""
    strange: float = 0.5
    """least part of the misfit of an event that forces of state and command do not predict [-]"""
    passes: int = 4
    """over all windows, at most: events found in one no longer blur the next"""
    ordinary: float = 3.0
    """times the usual misfit up to which a window that was left out holds no event after all [-]"""
    strong: float = 5.0
    """times the usual missed force in the middle of a burst [-]"""
    weak: float = 3.0
    """times the usual missed force at the ends of a burst [-]"""
    sure: float = 8.0
    """standard deviations by which the force in the middle of a burst differs from 0"""
    of_acting: float = 0.05
    """part of the force that accelerates the joint meanwhile, at least [-]: where an elbow whips
    round, masses wrong by 1 to 3 % miss up to 0.024 of it (`rough`, seeds 5 and 8)"""
    often: float = 0.2
    """part of the windows beyond which bursts are no accident [-]"""
    others: int = 60
    """windows without a burst, at most, that tell what state and command do, for the cost"""
    burst_passes: int = 6
    """to find bursts, at most"""
    recurring: float = 0.01
    """probability of so many events at one place by chance below which they are no accidents [-]"""


@dataclass(frozen=True)
class ForceThresholds:
    """The force that a model misses: how it is sought, and when a learned one is worth it."""

    short_s: float = 0.36
    """length of the windows in which a force is sought [s]: their response to it is linear"""
    hold_s: float = 0.06
    """for which a force is held that stands for the one that is missed [s]"""
    lengthscales: tuple[float, float] = (0.05, 0.2)
    """of the missed force over coordinates that range over about 2 [-]: a contact is sharp"""
    strengths: tuple[float, ...] = (1e-2, 1e-1, 1.0)
    """std of the missed force that are tried, in usual forces of a joint [-]"""
    slow: float = 0.1
    """speed, in a joint's rms, below which speeds are spread out [-]: dry friction turns over"""
    most_turned_rad: float = 8.0
    """turn of a hinge beyond which its angle and its place in a turn are two things [rad]"""
    folds: int = 4
    """of the cross-validation over windows"""
    most_unknown: int = 1200
    """forces in the windows from which others are predicted, at most, for the cost"""
    parts: int = 4
    """of a learned force, at most"""
    worth: float = 0.15
    """least part of the log misfit that a further part must predict [-]"""
    worth_a_pair: float = 0.06
    """part of the log misfit that a force over two coordinates must predict beyond one's [-]"""
    fits: float = 0.05
    """mean log misfit below which nothing is left to explain [-]"""
    knots: float = 0.6
    """from knot to knot of a learned force's grid, in lengthscales [-]"""
    learned_slow: float = 0.03
    """as `slow`, for the grid of a learned force [-]"""
    learned_strengths: tuple[float, ...] = (0.05, 0.2, 0.8)
    """as `strengths`, for a learned force [-]"""
    inflation: float = 0.05
    """part of a window's misfit that counts as noise [-]"""
    least_variance: float = 0.03
    """prior variance of a direction of a grid below which it is left out [-]"""
    informed: float = 0.1
    """information of the data on a direction, over the prior's, below which it is left out [-]"""
    iterations_short: int = 6
    """of the fit of a learned force to short windows"""
    iterations: int = 8
    """of its fit to all windows"""
    most_of_force: float = 0.85
    """part of the squared force that the reported region holds [-]"""


@dataclass(frozen=True)
class ComparisonThresholds:
    """Errors of free runs on held-out windows, with their intervals."""

    start_s: float = 0.3
    """of each window from which its start state is estimated [s]"""
    fewest: int = 5
    """windows that must be left when those are dropped whose motion diverges"""
    end: float = 0.1
    """last part of a window, whose error counts as that at its end [-]"""


@dataclass(frozen=True)
class VerdictThresholds:
    """Between `named`, `none`, `partly` and `unknown`, and which effects are not distinguished."""

    force: float = 0.02
    """random force beyond which something is missing [usual forces]; masses 3 % off leave half"""
    sure: float = 9.5
    """gain of deviance below which noise alone makes a random force in one of a thousand [-]"""
    whole: float = 1.0
    """random force in a joint beyond which effects but imitate it; none is named [usual forces]"""
    shifted: float = 5.0
    """prior std beyond which a fit takes a parameter elsewhere than its prior meant [-]"""
    noise: float = 3.0
    """noise std over the reported one beyond which something is missing [-]"""
    lasting: float = 0.5
    """part of the random force that is left in a joint that may be alike in all windows [-]: in
    `rough`, seeds below 100, intervals hold 32 of 34 parameters, and 28 without it"""
    closed: float = 0.5
    """part of the held-out error that effects must take away; surely, where more is missing [-]"""
    far: float = 2.0
    """times the misfit of the fitted windows that held-out ones must reach for that to count [-]"""
    tied: float = 20.0
    """difference in BIC below which sets of effects cannot be distinguished; above `bic_gain`"""
    slight: float = 0.5
    """change of the motions by an effect below which it is not told, in the most that a parameter
    does, 1 % wrong, of bodies as told [-]: MuJoCo's steps make 0.1 to 0.4 of lags, 0.55 hidden"""
    nothing: float = 6.0
    """times what noise does that a plant may miss which lacks nothing [-]; sound ones have 3.4"""
    unexplained: float = 20.0
    """times what noise does that a corrected plant may miss unsaid [-]; effects leave 16 at most"""
    unlearned: float = 200.0
    """likewise where more is missing than effects, but no `whole` force [-]; sound ones have 160"""
    unseen: float = 1.0
    """sensitivity to a usual effect below which one of five times its size may hide [noise std]"""


DATA = DataThresholds()
BUDGET = BudgetThresholds()
FIT = FitThresholds()
DISTURBANCE = DisturbanceThresholds()
SCREEN = ScreenThresholds()
SEARCH = SearchThresholds()
EVENT = EventThresholds()
FORCE = ForceThresholds()
COMPARISON = ComparisonThresholds()
VERDICT = VerdictThresholds()
