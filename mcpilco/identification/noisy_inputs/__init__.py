"""Linear regression where the inputs are noisy, as a robot's regressor of measured motions is.

`Moments` hold all that regression needs of the data, a `Solution` what it found. Noise of the
inputs that is known is taken out by `errors_in_variables`, noise that something measured does not
share by `instrumental_variables` and `refine`; `noise_of_repetitions` and `noise_above` find its
size in the recording. `fit_noisy_inputs` finds noise and coefficients together by the variational
EM of Ting et al., and `UnidentifiedWarning` says what of that is an assumption. `METHODS` has these
and the usual methods behind one signature, to be compared.

Read `regression`, then `em` with `bayesian` (one algorithm: its steps, and what is made of them),
then `methods`.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
