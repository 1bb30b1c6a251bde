"""The joint input-output approach: the FRFs from the reference to y and to u, and their ratio."""

from .._errors import input_error
from ..spectra import Spectra
from .classical import H1, check_independent
from .least_squares import AbstractLeastSquares
from .method import AbstractMethod, Estimate, Signals


class JointInputOutput(AbstractMethod):
    """G = G_ry G_ru^-1, both estimated from the reference by the same method: JIO with `H1`, JIO-LRM with `LRM`.

    In closed loop the noise in y comes back in u, and whatever regresses y on u is biased by it; the reference is free
    of noise, so this estimator is consistent (Zimmermann & Moberg, Eq. (JIO) and Section II.C.3; Wellstead 1981).
    It needs the recorded reference, as many references as inputs, and fails where the reference does not excite.

    The covariance is carried through the ratio: with W = G_ru^-T,

        Cov(vec G) = J Cov(vec [G_ry; G_ru]) J^H,   J = W (x) [I, -G],

    the correlation between the two estimates included.

    **Arguments:** `method`: `H1()` (default), `LPM`, `LRM`, `MisoLRM` or `CommonDenominatorLRM`.

    **Raises:** (in `jaxfrf.estimate`) `jaxfrf.InputError` without a reference, for another number of references than
    inputs, and where the method does.

    **Source:** Wellstead, Automatica 17 (1981) 55-69; Zimmermann & Moberg, Eq. (JIO) and section II.C.3. The covariance
    is first order, a closed form.
    """

    method: AbstractLeastSquares = H1()

    def block_size(self, spectra: Spectra | Signals) -> int:
        return self.method.block_size(spectra)

    @property
    def looks(self) -> bool:
        return self.method.looks

    @property
    def shares_lines(self) -> bool:
        return self.method.shares_lines

    def calls_lapack(self, spectra: Spectra) -> bool:
        return self.method.calls_lapack(spectra, joint=True)

    def check(self, spectra: Spectra) -> None:
        if spectra.R is None:
            raise input_error(
                "r",
                "no reference in the data",
                "the recorded reference, from which the joint input-output approach estimates",
                "Name it (--map r=...), or take a method without it (h1, log, lrm-mimo).",
            )
        if spectra.R.shape[-1] != spectra.n_in:
            raise input_error(
                "r",
                f"{spectra.R.shape[-1]} references and {spectra.n_in} inputs",
                "as many references as inputs",
                "Choose the channels of r that drive the inputs.",
            )
        if self.block_size(spectra) > 1 and spectra.n_exp >= spectra.n_in:
            check_independent("r", spectra.R)
        self.method.check(spectra)

    def residual_dof(self, signals: Signals) -> float:
        return self.method.plan(signals, joint=True).dof

    def at_point(self, signals: Signals, lines=None) -> Estimate:
        return self.method.joint(signals, lines)
