"""Recordings: log files become arrays with units, and what is wrong with them is said.

A file is a `table` of named columns (CSV, npz, mat, parquet). One `reader` picks the columns, puts
the rows in the order of their time stamps and leaves out those that repeat or run backwards. What
it read becomes one of

- `Recording`: states and inputs on a uniform grid, with gaps and noise (`read_recording`); a
  robot's `Segment` (`read_robot`), its `JointMotion` (`zero_phase`, `local_cubics`) and
  `JointData` (`joint_data`) are made of recordings;
- `ArmRecording` and its `ArmSamples`: positions, currents and targets of an arm (`read_arm`);
- `MarkerRecording`: poses of markers that a camera saw (`read_markers`);
- `Series`: inputs and outputs, sample by sample (`read_series`).

Read `table`, `reader`, `recording`; then `resample`, `smoothing`, `noise` and `suspicion`, or the
module of the kind that you need. `misread` asks a plant whether the columns are the right ones,
`unpowered` where its actuators were off; `excitations` makes inputs that are worth recording.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
