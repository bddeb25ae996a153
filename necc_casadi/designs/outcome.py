"""What the solver reports, as values: IPOPT's statuses in one table, with what to try next."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from necc_casadi.cases import Mode

__all__ = ["STATUS", "Residual", "Start", "Status", "solver_seconds"]


@dataclass(frozen=True)
class Status:
    """Meaning of one IPOPT return status."""

    usable: bool  # the iterate may satisfy the constraints; its loss decides
    meaning: str
    remedy: str


#: IPOPT's return statuses (IpReturnCodes_inc.h of Ipopt 3.14) and what to try next.
STATUS: dict[str, Status] = {
    "Solve_Succeeded": Status(True, "solved", ""),
    "Solved_To_Acceptable_Level": Status(
        True, "solved to a looser tolerance", "Usually fine: the loss tells."
    ),
    "Feasible_Point_Found": Status(True, "feasible point found", ""),
    "Search_Direction_Becomes_Too_Small": Status(
        True, "stopped: steps too small", "Try another --seed or more --starts."
    ),
    "Maximum_Iterations_Exceeded": Status(
        True, "iteration limit reached", "Try more --starts, or wider networks."
    ),
    "Maximum_CpuTime_Exceeded": Status(True, "time limit reached", "Try smaller networks."),
    "Maximum_WallTime_Exceeded": Status(True, "time limit reached", "Try smaller networks."),
    "User_Requested_Stop": Status(True, "stopped on request", ""),
    "Infeasible_Problem_Detected": Status(
        False, "converged to a locally infeasible point", "Lower --a, or try more --starts."
    ),
    "Diverging_Iterates": Status(
        False, "iterates diverge", "Lower --a, or scale the states to similar size."
    ),
    "Restoration_Failed": Status(
        True, "restoration phase failed", "Try another --seed, or lower --a."
    ),
    "Error_In_Step_Computation": Status(
        True, "step computation failed", "Try another --seed, or scale the states."
    ),
    "Invalid_Number_Detected": Status(
        False, "NaN or Inf met", "Check the model for poles near the target."
    ),
    "Not_Enough_Degrees_Of_Freedom": Status(
        False, "fewer weights than conditions", "Use wider networks."
    ),
    "Insufficient_Memory": Status(False, "out of memory", "Use smaller networks."),
}


_UNKNOWN = Status(False, "solver failed", "Try another --seed; --debug shows IPOPT's output.")


@dataclass(frozen=True)
class Start:
    """Outcome of one start of the solver."""

    seed: int
    mode: Mode
    status: str  # IPOPT's return status
    iterations: int
    objective: float  # shape objective (hard, shaped) or ε (soft), as IPOPT saw it
    loss: float  # ε recomputed from the weights (eq. Loss)
    seconds: float | None = None  # inside IPOPT; of the run, so not a part of a stored design

    @property
    def explained(self) -> Status:
        """Meaning of the status and what to try next."""
        return STATUS.get(self.status, _UNKNOWN)


def solver_seconds(starts: Iterable[Start]) -> float:
    """Time inside IPOPT, all starts of this run together, s."""
    return sum(start.seconds or 0.0 for start in starts)


@dataclass(frozen=True)
class Residual:
    """‖∇Cᵀ(Jcl − Rcl)‖ / (‖∇C‖ ‖Jcl − Rcl‖) on points that were not trained on."""

    mean: float
    worst: float
    points: int
