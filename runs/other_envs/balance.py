"""What MC-PILCO must know of Gymnasium's InvertedPendulum-v5."""

from mcpilco import TaskSpec
from mcpilco.policies import SaturatingCost

TASK = TaskSpec(
    state_names=("cart_position", "pole_angle", "cart_velocity", "pole_velocity"),
    state_units=("m", "rad", "m/s", "rad/s"),
    input_names=("control",),
    input_units=("-",),
    dt=0.04,  # two steps of MuJoCo, of 0.02 s
    angles=(1,),
    velocities=((0, 2), (1, 3)),
    start_mean=(0.0, 0.0, 0.0, 0.0),
    start_std=(0.006, 0.006, 0.006, 0.006),  # uniform within 0.01
    # near 0 upright at the origin, near 1 where the episode ends, at 0.2 rad
    cost=SaturatingCost((0, 1), (0.0, 0.0), (0.5, 0.2), (False, False)),
)
