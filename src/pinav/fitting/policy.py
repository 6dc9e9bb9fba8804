"""All constants of the search for a structure, in one place."""

import equinox as eqx


class SearchPolicy(eqx.Module):
    """Limits and thresholds of a search for a structure.

    A misfit is the standard deviation of the residuals that terms leave, relative to
    the noise; a share is one of the extent of most of the data. Pairs of numbers are
    for a plane and for space, in which many more places are scanned.

    Attributes:
        decisive: nats that decide between two structures; simplification may lose twice
            as many, since it is asked again about the fit.
        clear: nats by which a fit has lost to another, converged or not, before the
            cost of their hyperparameters.
        content: misfit at which nothing is left to explain.
        settled: misfit of terms about their own fit above which something is missing.
        explained: misfit above which terms are not fitted to the end: free kernels
            would have to carry too much.
        hopeless: misfit above which terms are not worth a fit. Smoothed states miss the
            path of quick swimmers, and the right term may leave this much about them.
        plain: factor by which a mixture must leave less than a potential does for the
            force to turn plainly: potentials on too coarse kernels leave up to 2.1
            times as much, swirls 4.4 to 21 times.
        same: change of the misfit of terms, relative to it, that is none.
        fitted: proposals whose fit is tried, one after the other, until one succeeds.
        moved: trials of a stage, the most likely ones, whose geometry is moved.
        moves: steps of a trial at each smoothness, at most.
        polished: trials that are polished, of those that were moved.
        parents: proposals beside which a third term is sought.
        rounds: of linearising about the fit of what was found, at most.
        first_steps: of a fit about which the data are linearised.
        polish_steps: of the engine for the geometry of a proposal.
        grid: places of centres along each side of the data.
        ranks: shares of the data along each axis at which further centres are tried:
            where swimmers are flung out the even grid is coarse.
        angles: directions of walls.
        shears: sizes of those of scanned ellipses: axes in the ratio of 2.2 and of 6.
        turns: directions of ellipses.
        dense: places of ellipses along each axis, beside the summits: an even grid is
            too coarse where swimmers are flung out.
        periods: of a lattice across the data, at most.
        centers: of obstacles of one kind, at most.
        sets: pairs of centres from which such obstacles are grown.
        smoothness: length scales of profiles that are tried, as shares of the extent;
            the last one in a scan.
        directions: of the weights of a scanned term that the data see most.
        ratios: variances of the noise tried in a scan, relative to that of a term; the
            second one for pairs and sets.
        kernels: of a profile across the ground that most of the data are on.
        halvings: of the width of the kernels of a profile, at most.
        shortest: length scale of a profile or a wave, in widths of its kernels, below
            which they are too coarse: a process of few derivatives needs several.
        reached: share of the data that the kernels of a profile must reach; those of a
            term that left the data determine nothing.
        trajectories: that a survey looks at; the fits see all.
        least_data: trajectories and observed numbers below which none is sought.
        lawful: misfit of a law relative to that of the kernels of its profile, above
            which it is no law of it.
    """

    decisive: float = 5.0
    clear: float = 100.0
    content: float = 1.2
    settled: float = 1.1
    explained: float = 1.7
    hopeless: float = 5.0
    plain: float = 3.0
    same: float = 0.1
    fitted: int = 2
    moved: int = 4
    moves: int = 10
    polished: int = 2
    parents: int = 2
    rounds: int = 2
    first_steps: int = 3
    polish_steps: int = 8
    grid: tuple[int, int] = (7, 5)
    ranks: tuple[int, int] = (7, 3)
    angles: int = 18
    shears: tuple[float, ...] = (0.4, 0.9)
    turns: int = 12
    dense: int = 5
    periods: int = 6
    centers: int = 8
    sets: int = 4
    smoothness: tuple[float, float] = (0.1, 0.03)
    directions: int = 24
    ratios: tuple[float, ...] = (1e-3, 1e-5, 1e-7)
    kernels: tuple[int, int] = (36, 18)
    halvings: int = 2
    shortest: float = 4.0
    reached: float = 0.5
    trajectories: tuple[int, int] = (32, 10)
    least_data: tuple[int, int] = (6, 600)
    lawful: float = 1.25

    def looked_at(self, count: int, dim: int) -> slice:
        """Trajectories that a survey of so many looks at, equally far apart."""
        return slice(None, None, -(-count // self.trajectories[dim == 3]))


POLICY = SearchPolicy()
"""The policy that every search follows."""
