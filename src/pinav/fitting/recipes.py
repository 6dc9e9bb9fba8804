"""Named compositions of phases."""

from pinav.fitting.phases import LBFGS, AbstractPhase, Adam


def paper_recipe(
    adam_steps: int = 7500, lbfgs_steps: int = 500
) -> tuple[AbstractPhase, ...]:
    """The paper's two phases: Adam at 0.01, then L-BFGS.

    Args:
        adam_steps: 7500 in the paper.
        lbfgs_steps: 500 in the paper.

    References:
        PI-NAV paper, Table 1.
    """
    return Adam(learning_rate=1e-2, steps=adam_steps), LBFGS(steps=lbfgs_steps)
