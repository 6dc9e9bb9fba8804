"""Terms whose force is a profile of a distance: from points, walls and segments.

Their first fields are the weights: the height of the law, if any, then those of the
kernels of the profile [L T⁻²]. `places` and `width` of the kernels [L] are fixed.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from pinav.arguments import Scalar, Vector
from pinav.forces.profiles import FittedLaw
from pinav.forces.structures import (
    ROUNDING,
    AbstractProfileTerm,
    Places,
    distance,
    exponential_of_shear,
)


class CentralTerm(AbstractProfileTerm):
    r"""A force about a centre, $f(r)\,\hat r$ with $r = |x - c|$, or a swirl about it.

    Attributes:
        center: $c$ [L].
    """

    weights: Float[Array, " weight"]
    center: Vector
    places: Places
    width: Scalar
    rotational: bool = eqx.field(static=True, default=False)
    law: FittedLaw | None = None

    kinds = ("central", "central swirl")
    formulas = (r"f(|x - c|)\,\hat r", r"f(|x - c|)\,\hat\varphi")
    shaped_by = ("center",)

    def coordinates(self, x: Vector) -> Float[Array, " coordinate"]:
        return distance(x - self.center, ROUNDING * self.width)[None]


class EllipticTerm(AbstractProfileTerm):
    r"""A force whose potential has similar ellipses for contours.

    $z = \sqrt{(x - c)^\top e^{2S} (x - c)}$ with a traceless symmetric $S$ of the
    entries $(p, q)$: $e^{2|S|}$ is the ratio of the axes.

    Attributes:
        center: $c$ [L].
        shear: $p$ and $q$.
    """

    weights: Float[Array, " weight"]
    center: Float[Array, "2"]
    shear: Float[Array, "2"]
    places: Places
    width: Scalar
    rotational: bool = eqx.field(static=True, default=False)
    law: FittedLaw | None = None

    kinds = ("elliptic",) * 2
    formulas = (r"f(z)\,\nabla z,\ z^2 = (x - c)^\top e^{2S} (x - c)",) * 2
    shaped_by = ("center", "shear")

    @property
    def placement_scales(self) -> tuple[float, ...]:
        return self.reach, 1.0

    def coordinates(self, x: Vector) -> Float[Array, " coordinate"]:
        root = exponential_of_shear(self.shear[0], self.shear[1])
        return distance(root @ (x - self.center), ROUNDING * self.width)[None]


class WallTerm(AbstractProfileTerm):
    r"""A force along one direction that depends on the place along it, $f(z)\,n$.

    $z = n \cdot (x - x_0)$ with $n = (\cos\phi, \sin\phi)$: a wall, a layer, a channel,
    or, turned, a shear flow.

    Attributes:
        angle: $\phi$ of the normal to the x axis [rad].
        origin: $x_0$ [L]; fixed.
    """

    weights: Float[Array, " weight"]
    angle: Float[Array, ""] = eqx.field(converter=jnp.asarray)
    origin: Float[Array, "2"]
    places: Places
    width: Scalar
    rotational: bool = eqx.field(static=True, default=False)
    law: FittedLaw | None = None

    kinds = ("wall", "shear layer")
    formulas = (r"f(n \cdot x)\,n", r"f(n \cdot x)\,n^\perp")
    shaped_by = ("angle",)
    is_odd = False

    @property
    def placement_scales(self) -> tuple[float, ...]:
        return (1.0,)

    @property
    def offset(self) -> Scalar:
        return self._normal @ self.origin

    def coordinates(self, x: Vector) -> Float[Array, " coordinate"]:
        return (self._normal @ (x - self.origin))[None]

    @property
    def _normal(self) -> Float[Array, "2"]:
        return jnp.stack([jnp.cos(self.angle), jnp.sin(self.angle)])


class SegmentTerm(AbstractProfileTerm):
    r"""A force away from a segment, a fibre with round ends; or a swirl about it.

    Attributes:
        ends: of the segment [L].
    """

    weights: Float[Array, " weight"]
    ends: Float[Array, "2 2"]
    places: Places
    width: Scalar
    rotational: bool = eqx.field(static=True, default=False)
    law: FittedLaw | None = None

    kinds = ("segment",) * 2
    formulas = (r"f(z)\,\nabla z,\ z = \mathrm{dist}(x, \overline{ab})",) * 2
    shaped_by = ("ends",)

    def coordinates(self, x: Vector) -> Float[Array, " coordinate"]:
        along = self.ends[1] - self.ends[0]
        length = along @ along + (ROUNDING * self.width) ** 2
        fraction = jnp.clip((x - self.ends[0]) @ along / length, 0.0, 1.0)
        offset = x - self.ends[0] - fraction * along
        return distance(offset, ROUNDING * self.width)[None]


class ObstaclesTerm(AbstractProfileTerm):
    r"""Obstacles of one kind: central forces about several centres, one profile.

    Attributes:
        centers: $c_k$ [L].
    """

    weights: Float[Array, " weight"]
    centers: Float[Array, "center dim"]
    places: Places
    width: Scalar
    rotational: bool = eqx.field(static=True, default=False)
    law: FittedLaw | None = None

    kinds = ("obstacles",) * 2
    formulas = (r"\sum_k f(|x - c_k|)\,\hat r_k",) * 2
    shaped_by = ("centers",)

    def coordinates(self, x: Vector) -> Float[Array, " coordinate"]:
        rounding = ROUNDING * self.width
        return jax.vmap(lambda c: distance(x - c, rounding))(self.centers)
