"""A model in other units: states, time and energy rescaled in its text."""

from dataclasses import dataclass, field

import sympy as sp

from necc_casadi.model.model_file import Model
from necc_casadi.model.plant import make_plant


@dataclass(frozen=True)
class Change:
    """One old unit in new ones: a number x in the old is `state`·x in the new."""

    state: dict[str, sp.Rational] = field(default_factory=dict)
    time: sp.Rational = sp.S.One
    energy: sp.Rational = sp.S.One

    def of(self, name) -> sp.Rational:
        return self.state.get(str(name), sp.Integer(1))


def converted(model: Model, change: Change) -> Model:
    """The same plant, written in other units, with inputs such that u·y is a power."""
    plant = model.loop.plant
    size = [change.of(s) for s in plant.x]
    back = {s: s / f for s, f in zip(plant.x, size, strict=True)}
    E, T = change.energy, change.time

    def new(matrix, factor):
        return sp.Matrix(
            matrix.rows, matrix.cols, lambda i, j: matrix[i, j].xreplace(back) * factor(i, j)
        )

    def structure(i, j):
        return size[i] * size[j] / (E * T)

    u = E / T  # y keeps its number
    made = make_plant(
        plant.x,
        new(plant.J, structure),
        new(plant.R, structure),
        new(plant.G, lambda i, j: size[i] / (T * u)),
        plant.H.xreplace(back) * E,
        name=plant.name,
        domain={
            name: (lo * change.of(name), hi * change.of(name))
            for name, (lo, hi) in plant.domain.items()
        },
        u_limits=None
        if plant.u_limits is None
        else [(lo * float(u), hi * float(u)) for lo, hi in plant.u_limits],
    )
    return Model(made)


def converted_target(x_star, change: Change):
    return {s: v * change.of(s) for s, v in x_star.items()}
