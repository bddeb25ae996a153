"""The published training method on the pendulum, in PyTorch: what the tool is timed against.

Our own port of the paper's description: V = H + Hc + K(q − ξ) with plain tanh networks, eq. Loss
differentiated through autograd, three Adam optimisers (K, Hc, ξ*) at 1e-4, ξ* from a standard
normal. float32 throughout, PyTorch's default. Needs ``torch``, which the package itself does not.

Two recipes. "separate": the loss is evaluated anew for each optimiser, by the functional Jacobian
and Hessian, as a trainer with several optimisers does; its losses match the published size.
"shared": one evaluation per epoch for all three, row by row; the same method at a third of the
cost, so that no speed-up rests on a slow opponent.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import torch
from torch import Tensor, nn

__all__ = ["AuthorsResult", "train"]

Derivatives = Callable[["Lyapunov", Tensor], tuple[Tensor, Tensor]]

Q_STAR = math.pi / 4
A = 0.5  # least eigenvalue that eq. Loss asks of ∇²V(z*)
STEP = 1e-4  # Adam's step size, for all three optimisers
NEARBY = 2.0  # how far from z* Newton may look for z̄
NEWTON_STEPS = 50
NEWTON_TOLERANCE = 1e-10  # on ‖∇V(z̄)‖, in float64


@dataclass(frozen=True)
class AuthorsResult:
    """One training run: what it cost and what it reached."""

    seconds: float  # wall time of the epochs alone: no import, no set-up, no final check
    loss: float  # eq. Loss in float32 after the last step
    xi_star: float  # trained controller equilibrium
    distance: float | None  # ‖z̄ − z*‖, z̄ the minimum of V; None where Newton finds none near z*
    epochs: int


class Lyapunov(nn.Module):
    """V(z) = p²/2 + 1 − cos q + Hc(ξ) + K(q − ξ), and the trainable ξ*."""

    def __init__(self, hidden_k: Sequence[int], hidden_h: Sequence[int]) -> None:
        super().__init__()
        self.k = _tanh_network(hidden_k)
        self.hc = _tanh_network(hidden_h)
        self.xi_star = nn.Parameter(torch.randn(1))
        self.register_buffer("x_star", torch.tensor([Q_STAR, 0.0]))

    def forward(self, z: Tensor) -> Tensor:
        """V at one state z = (q, p, ξ), scalar."""
        q, p, xi = z.split(1)
        energy = p * p / 2 + 1 - q.cos()
        return (energy + self.hc(xi) + self.k(q - xi)).squeeze()

    def z_star(self) -> Tensor:
        """(q*, 0, ξ*), (3,), with a graph back to ξ*."""
        return torch.cat([self.x_star, self.xi_star])


def _tanh_network(hidden: Sequence[int]) -> nn.Sequential:
    """ℝ → ℝ with PyTorch's default initial weights; the output layer is affine."""
    layers: list[nn.Module] = []
    for columns, rows in pairwise((1, *hidden)):
        layers += [nn.Linear(columns, rows), nn.Tanh()]
    return nn.Sequential(*layers, nn.Linear(hidden[-1], 1))


def _derivatives(V: Lyapunov, z: Tensor) -> tuple[Tensor, Tensor]:
    """∇V (3,) and ∇²V (3, 3) at z, row by row, with graphs back to the weights and ξ*."""
    (gradient,) = torch.autograd.grad(V(z), z, create_graph=True)
    rows = [torch.autograd.grad(entry, z, create_graph=True)[0] for entry in gradient]
    return gradient, torch.stack(rows)


def _functional(V: Lyapunov, z: Tensor) -> tuple[Tensor, Tensor]:
    """The same two by the functional interface, each with a forward pass of its own."""
    gradient = torch.autograd.functional.jacobian(V, z, create_graph=True)
    return gradient, torch.autograd.functional.hessian(V, z, create_graph=True)


def _loss(V: Lyapunov, derivatives: Derivatives = _derivatives) -> Tensor:
    """eq. Loss: ‖∇V(z*)‖ + ReLU(−λ_min(∇²V(z*) − aI))."""
    gradient, hessian = derivatives(V, V.z_star())
    lowest = torch.linalg.eigvalsh(hessian)[0] - A  # ascending order
    return torch.linalg.vector_norm(gradient) + torch.relu(-lowest)


def train(
    hidden_k: Sequence[int],
    hidden_h: Sequence[int],
    seed: int,
    epochs: int = 2000,
    recipe: str = "separate",
) -> AuthorsResult:
    """Train K (widths `hidden_k`), Hc (widths `hidden_h`) and ξ* from the random state `seed`.

    Sets PyTorch's global seed, and one thread: these networks are too small to share out.
    """
    torch.set_num_threads(1)
    torch.manual_seed(seed)
    V = Lyapunov(hidden_k, hidden_h)
    groups = (V.k.parameters(), V.hc.parameters(), [V.xi_star])
    optimisers = [torch.optim.Adam(group, lr=STEP) for group in groups]

    epoch = {"separate": _separate_epoch, "shared": _shared_epoch}[recipe]
    start = time.perf_counter()
    for _ in range(epochs):
        epoch(V, optimisers)
    seconds = time.perf_counter() - start

    return AuthorsResult(seconds, _loss(V).item(), V.xi_star.item(), _distance(V.double()), epochs)


def _separate_epoch(V: Lyapunov, optimisers: Sequence[torch.optim.Optimizer]) -> None:
    for optimiser in optimisers:
        optimiser.zero_grad()
        _loss(V, _functional).backward()
        optimiser.step()


def _shared_epoch(V: Lyapunov, optimisers: Sequence[torch.optim.Optimizer]) -> None:
    for optimiser in optimisers:
        optimiser.zero_grad()
    _loss(V).backward()
    for optimiser in optimisers:
        optimiser.step()


def _distance(V: Lyapunov) -> float | None:
    """‖z̄ − z*‖ by Newton on ∇V from z*, for a V in float64; None without a minimum nearby.

    Nearby, because far out the networks saturate and ∇V vanishes where there is no minimum.
    """
    z_star = torch.tensor([Q_STAR, 0.0, V.xi_star.item()], dtype=torch.float64)
    offset = torch.zeros_like(z_star)
    for _ in range(NEWTON_STEPS):
        z = (z_star + offset).requires_grad_()
        gradient, hessian = (t.detach() for t in _derivatives(V, z))
        if gradient.norm() < NEWTON_TOLERANCE:
            is_minimum = torch.linalg.eigvalsh(hessian)[0] > 0
            return offset.norm().item() if is_minimum else None
        offset = offset - torch.linalg.lstsq(hessian, gradient).solution
        if not offset.norm() <= NEARBY:  # also where it is not a number
            return None
    return None
