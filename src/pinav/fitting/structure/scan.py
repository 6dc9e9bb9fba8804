r"""Quick evidence of many terms beside others: one smoothness, and products of columns.

A column is what the data see of one direction of the weights of a term. With the
columns $X$ of all terms of a trial, each term's scaled to unit trace, amplitudes and
noise in the ratio $\beta$, and with the residuals $r$ of no force

$$\log Z = -\tfrac n2 \log\bigl(r^\top r
    - r^\top X (X^\top X + \beta)^{-1} X^\top r\bigr)
  - \tfrac12 \log\det(X^\top X/\beta + 1),$$

whose noise is profiled. All that it needs are products of columns with each other, so
that pairs of terms, and sets of centres with one profile, cost a small factorisation
each.
"""

import dataclasses
from collections.abc import Iterator, Sequence

import equinox as eqx
import numpy as np
import scipy.linalg
from jaxtyping import Float

from pinav.fitting.evidence.evidence import root
from pinav.fitting.policy import POLICY
from pinav.fitting.structure.response import ForceResponse, forces_by_weight
from pinav.fitting.structure.response import columns as by_weight
from pinav.fitting.structure.trials import cost, scanned_shapes
from pinav.forces import AbstractTerm

SAMPLE = 8
"""Terms of a kind whose data tell which directions of their weights count."""

ROUNDING = 1e-12
"""Share of the squares that is rounding."""


class Atoms(eqx.Module):
    """Terms of one kind at different places, and their columns.

    Attributes:
        columns: of each term, scaled to unit trace: each is as likely as any other to
            explain a share of the data. They are held in single precision, and
            multiplied in double: products of rounded columns stay positive definite.
        products: of the columns of a term with each other.
        sizes: root of the trace of the columns of each before.
        price: cost of the geometry of one of them [nats].
    """

    terms: Sequence[AbstractTerm]
    columns: Float[np.ndarray, "datum atom direction"]
    products: Float[np.ndarray, "atom direction direction"]
    sizes: Float[np.ndarray, " atom"]
    price: float

    @classmethod
    def of(cls, terms: Sequence[AbstractTerm], response: ForceResponse) -> "Atoms":
        """The columns of terms that differ in their geometry alone."""
        made, products, sizes = np.zeros(0, np.float32), [], []
        for index, columns in enumerate(_seen_columns(terms, response)):
            if not made.size:
                shape = len(columns), len(terms), columns.shape[1]
                made = np.empty(shape, np.float32)
            size = max(float(np.linalg.norm(columns)), np.finfo(float).tiny)
            made[:, index] = columns / size
            rounded = made[:, index].astype(float)
            products.append(rounded.T @ rounded)
            sizes.append(size)
        price = cost((terms[0],), response)
        return cls(terms, made, np.stack(products), np.array(sizes), price)

    def __getitem__(self, chosen: slice) -> "Atoms":
        """Some of the terms."""
        return dataclasses.replace(
            self,
            terms=self.terms[chosen],
            columns=self.columns[:, chosen],
            products=self.products[chosen],
            sizes=self.sizes[chosen],
        )

    def times(
        self, columns: Float[np.ndarray, " datum *some"]
    ) -> Float[np.ndarray, "*some atom direction"]:
        """Products of the columns with others."""
        each = np.moveaxis(self.columns, 1, 0)
        return np.stack([columns.T @ one for one in each], axis=-2)


def _seen_columns(
    terms: Sequence[AbstractTerm], response: ForceResponse
) -> Iterator[Float[np.ndarray, "datum direction"]]:
    """Columns of each term by the directions of the weights that the data see most.

    They are those of a few of the terms together: of the prior alone the directions of
    most variance may all be where there are no data.
    """
    prior = terms[0].prior()
    whole = root(prior.covariance(scanned_shapes(terms[0], response)[-1]))
    if whole.shape[1] > POLICY.directions:
        seen = np.zeros((whole.shape[1],) * 2)
        for term in terms[:: -(-len(terms) // SAMPLE)]:
            rows = by_weight(term, response) @ whole
            seen += rows.T @ rows / max(float((rows**2).sum()), np.finfo(float).tiny)
        whole = whole @ np.linalg.eigh(seen)[1][:, -POLICY.directions :]
    if len(terms) == 1:
        yield by_weight(terms[0], response) @ whole
        return
    for forces in forces_by_weight(terms, response):
        yield response.change(forces @ whole)


class Held(eqx.Module):
    """Columns that all trials of a scan share, and the data.

    Attributes:
        columns: of the terms beside which others are tried.
        offset: residuals of no force.
        squares: of all residuals of no force.
    """

    columns: Float[np.ndarray, "datum column"]
    offset: Float[np.ndarray, " datum"]
    squares: float
    num_free: int

    @classmethod
    def of(cls, terms: Sequence[AbstractTerm], response: ForceResponse) -> "Held":
        """The columns of terms in the data of a response."""
        offset = response.residuals_of_none
        parts = [Atoms.of([term], response).columns[:, 0] for term in terms]
        columns = np.concatenate([np.zeros((len(offset), 0)), *parts], axis=1)
        squares = float(offset @ offset) + response.squares
        return cls(columns, offset, squares, response.num_free)

    def beside(self, atoms: Atoms) -> Float[np.ndarray, " atom"]:
        """Log evidence of each of several terms beside what is held [nats]."""
        columns = self.columns
        values = self._log_evidence(
            columns.T @ columns,
            columns.T @ self.offset,
            atoms.times(columns),
            atoms.products,
            atoms.times(self.offset),
        )
        return values - atoms.price

    def pairs(self, first: Atoms, second: Atoms) -> Float[np.ndarray, "first second"]:
        """Log evidence of each pair of two kinds beside what is held [nats].

        Of pairs of one kind, each once; none of a term and itself.
        """
        if second.columns.shape[:0:-1] > first.columns.shape[:0:-1]:
            return self.pairs(second, first).T  # few directions are quicker beside many
        made = np.full((len(first.terms), len(second.terms)), -np.inf)
        across, along = second.times(self.columns), second.times(self.offset)
        size = along.shape[1]
        flat = second.columns.reshape(len(self.offset), -1).astype(float)
        for index in range(len(first.terms)):
            start = index + 1 if first is second else 0
            if start == len(second.terms):
                break
            columns = first.columns[:, index].astype(float)
            between = (columns.T @ flat[:, start * size :]).reshape(
                columns.shape[1], -1, size
            )
            inner = np.concatenate([self.columns, columns], axis=1)
            made[index, start:] = self._log_evidence(
                inner.T @ inner,
                inner.T @ self.offset,
                np.concatenate([across[:, start:], between]),
                second.products[start:],
                along[start:],
                POLICY.ratios[1:2],
            )
        return made - first.price - second.price

    def set_of_one_profile(self, atoms: Atoms) -> tuple[float, list[int]]:
        """Log evidence [nats] and members of the best set of terms with one profile.

        Its columns are the sum of those of its members. A few of the best pairs, none
        with a member of another, are grown, and members exchanged, while that gains.
        """
        products = _SharedProfile.of(atoms, self)
        table = np.stack([products.join([one]) for one in range(len(atoms.terms))])
        made, used = [], set()
        for place in np.argsort(-table, axis=None):
            pair = [int(one) for one in divmod(int(place), len(table))]
            if used.isdisjoint(pair):
                used.update(pair)
                made.append(products.grow(pair, float(table[*pair])))
            if len(made) == POLICY.sets:
                break
        return max(made, key=lambda one: one[0])

    def _log_evidence(
        self,
        gram: Float[np.ndarray, "held held"],
        along: Float[np.ndarray, " held"],
        across: Float[np.ndarray, "held atom direction"],
        own: Float[np.ndarray, "atom direction direction"],
        own_along: Float[np.ndarray, "atom direction"],
        ratios: Sequence[float] = POLICY.ratios,
    ) -> Float[np.ndarray, " atom"]:
        """Log evidence at the best of the ratios, by the complement of what is held."""
        count, size = across.shape[1:]
        best = np.full(count, -np.inf)
        right = np.concatenate([along[:, None], across.reshape(len(along), -1)], axis=1)
        for ratio in ratios:
            lower = np.linalg.cholesky(gram + ratio * np.eye(len(along)))
            white = scipy.linalg.solve_triangular(lower, right, lower=True)
            done = white[:, 0]
            rest = np.moveaxis(white[:, 1:].reshape(-1, count, size), 0, 1)
            turned = np.swapaxes(rest, 1, 2)
            inner = np.linalg.cholesky(
                own + ratio * np.eye(size) - np.matmul(turned, rest)
            )
            left = own_along - np.matmul(turned, done)
            told = np.linalg.solve(inner, left[..., None])[..., 0]
            squares = self.squares - done @ done - (told**2).sum(axis=1)
            squares = np.maximum(squares, ROUNDING * self.squares)
            volume = np.log(np.diagonal(inner, axis1=1, axis2=2)).sum(axis=1)
            volume += np.log(np.diagonal(lower)).sum()
            volume -= 0.5 * (len(along) + size) * np.log(ratio)
            best = np.maximum(best, -0.5 * self.num_free * np.log(squares) - volume)
        return best


class _SharedProfile(eqx.Module):
    """Products of the columns of centres in their true relative sizes."""

    held: Held
    products: Float[np.ndarray, "atom direction atom direction"]
    across: Float[np.ndarray, "held atom direction"]
    along: Float[np.ndarray, "atom direction"]
    price: float
    each: float

    @classmethod
    def of(cls, atoms: Atoms, held: Held) -> "_SharedProfile":
        scaled = atoms.columns * (atoms.sizes / np.median(atoms.sizes))[:, None]
        flat, shape = scaled.reshape(len(scaled), -1), scaled.shape[1:]
        dim = np.size(atoms.terms[0].geometry[0])
        return cls(
            held=held,
            products=(flat.T @ flat).reshape(*shape, *shape),
            across=(held.columns.T @ flat).reshape(-1, *shape),
            along=(flat.T @ held.offset).reshape(shape),
            price=atoms.price,
            each=0.5 * dim * float(np.log(held.num_free)),
        )

    def join(self, chosen: list[int]) -> Float[np.ndarray, " atom"]:
        """Log evidence of a set with each other centre [nats]."""
        every = np.arange(len(self.along))
        between = self.products[chosen].sum(axis=0)
        across = np.moveaxis(between, 1, 0)
        own = self.products[every, :, every, :] + across + np.swapaxes(across, 1, 2)
        own = own + between[:, chosen].sum(axis=1)
        sizes = np.sqrt(np.trace(own, axis1=1, axis2=2))[:, None]
        sizes = np.maximum(sizes, np.finfo(float).tiny)
        columns = self.held.columns
        values = self.held._log_evidence(
            columns.T @ columns,
            columns.T @ self.held.offset,
            (self.across[:, chosen].sum(axis=1, keepdims=True) + self.across) / sizes,
            own / sizes[..., None] ** 2,
            (self.along[chosen].sum(axis=0) + self.along) / sizes,
            POLICY.ratios[1:2],
        )
        values -= self.price + self.each * len(chosen)
        values[chosen] = -np.inf
        return values

    def grow(self, chosen: list[int], value: float) -> tuple[float, list[int]]:
        """The value and members of the set, grown and exchanged while that gains."""
        while True:
            rests = [[c for c in chosen if c != one] for one in chosen]
            if len(chosen) < POLICY.centers:
                rests.append(chosen)
            options = []
            for rest in rests:
                values = self.join(rest)
                index = int(np.argmax(values))
                options.append((float(values[index]), [*rest, index]))
            best = max(options, key=lambda one: one[0])
            if best[0] < value + 1.0:
                return value, chosen
            value, chosen = best
