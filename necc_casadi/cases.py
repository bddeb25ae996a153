"""What a request may choose among, as types: the command line offers what the package knows."""

from __future__ import annotations

from typing import Literal

__all__ = [
    "NAME_IN_C",
    "Activation",
    "CasimirForm",
    "Format",
    "InitialXi",
    "Integrator",
    "Measured",
    "MethodName",
    "MethodWord",
    "Mode",
    "PhiForm",
    "Precision",
    "Shape",
    "Stop",
]


#: Of the hidden layers, element-wise.
Activation = Literal["tanh", "sin", "squareplus"]


#: The published loop, and what is done in its place.
MethodName = Literal["interconnection", "shaping", "modulated", "mechanical", "constant"]


#: One of them, or the first that holds the target.
MethodWord = Literal["auto", "interconnection", "shaping", "modulated", "mechanical", "constant"]


#: C = K(Σ βᵢ(cᵢ)) or K(c₁, …, c_r).
CasimirForm = Literal["sum", "joint"]


#: Φ = H + Hc + C, or a network with Φ₁ > 0.
PhiForm = Literal["sum", "neural"]


#: What is asked of V over the domain; "none" leaves V to the conditions at z*.
Shape = Literal["none", "regulariser", "level"]


#: Of the training program: g = 0, t = 0 imposed, alone, over samples, for cost or for the cost of
#: responses; or min s + t.
Mode = Literal["hard", "shaped", "cost", "polished", "soft"]


#: Where ξ starts: at ξ*, at ξ* + T(x(0) − x*), or at the minimum of V(x(0), ·).
InitialXi = Literal["target", "linear", "minimum"]


#: What keeps a response from what was asked: a mode of the plant that no input moves, the peak of
#: an input, the bound of ‖A‖, or that the program finds nothing faster in this structure.
Stop = Literal["unmoved_mode", "input_peak", "norm_bound", "structure"]


#: What the controller takes: the model's states, or (q, q̇) where they are (q, p).
Measured = Literal["state", "velocity"]


#: Of a figure.
Format = Literal["png", "pdf", "svg"]


#: Number type of the C controller.
Precision = Literal["double", "float"]


#: How the C controller advances its state over a sample.
Integrator = Literal["heun", "euler", "rk4", "casimir"]


#: How a name of the C code may begin, as a pattern: C99 tells names apart by 31 letters, and those
#: that begin with _ belong to compilers.
NAME_IN_C = r"[A-Za-z][A-Za-z0-9_]{0,30}"
