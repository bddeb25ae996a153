"""A lifted problem, to train or to differentiate."""

import numpy as np


def build(task, form, weights, xi, a=0.5):
    from helpers.constructed import make_design

    made = make_design(
        task.loop.plant,
        [task.x_star[s] for s in task.loop.plant.x],
        form,
        weights,
        xi,
        casimirs=task.casimirs,
        loop=task.loop,
    )
    m = task.loop.plant.m
    return type(made)(**{**vars_of(made), "damping": np.eye(2 * m), "a": a})


def vars_of(made):
    return {name: getattr(made, name) for name in made.__dataclass_fields__}
