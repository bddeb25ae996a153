"""Texts for places that do not take every letter: C code, narrow consoles, other people's names.

And names of rates.
"""

from __future__ import annotations

import unicodedata
from collections.abc import Sequence

__all__ = ["escaped", "to_ascii", "velocity_names"]


_GREEK = {
    "α": "alpha", "β": "beta", "γ": "gamma", "δ": "delta", "ε": "epsilon", "ζ": "zeta",
    "η": "eta", "θ": "theta", "ι": "iota", "κ": "kappa", "λ": "lambda", "μ": "mu", "ν": "nu",
    "ξ": "xi", "ο": "o", "π": "pi", "ρ": "rho", "σ": "sigma", "ς": "sigma", "τ": "tau",
    "υ": "upsilon", "φ": "phi", "χ": "chi", "ψ": "psi", "ω": "omega",
}  # fmt: skip


_SIGNS = {
    "·": "*", "×": "x", "−": "-", "–": "-", "—": "-", "‐": "-", "…": "...", "‖": "||",
    "≤": "<=", "≥": ">=", "≠": "!=", "≈": "~", "≡": "==", "≺": "<", "≻": ">", "⪯": "<=",
    "⪰": ">=", "→": "->", "←": "<-", "↦": "|->", "∂": "d", "∇": "grad ", "∈": " in ", "∘": "o",
    "√": "sqrt", "∞": "inf", "∩": " and ", "∪": " or ", "∫": "int ", "⊂": " in ", "⊃": " holds ",
    "⊥": "_|_", "⟨": "<", "⟩": ">", "─": "-", "└": "`", "├": "|", "│": "|", "•": "*", "✓": "ok",
    "′": "'", "″": "''", "‴": "'''", "°": "deg", "±": "+-", "½": "1/2", "µ": "u", "Ω": "Omega",
    "ũ": "w",  # as the law of the header has it
    "ᵀ": "'", "‘": "'", "’": "'", "“": '"', "”": '"', "«": '"', "»": '"', "¬": "not ",
    "\N{COMBINING MACRON}": "bar", "\N{COMBINING DOT ABOVE}": "dot",
    "\N{COMBINING CIRCUMFLEX ACCENT}": "hat",
}  # fmt: skip


def to_ascii(text: str) -> str:
    """`text` in ASCII, for people: ξ₁ ≤ z̄² becomes xi1 <= zbar^2; what has no such form, an escape.

    Control characters are left as they are; see :func:`escaped`.
    """
    result, raised = [], False
    for letter in text.replace("∇²", "hess "):
        plain = letter if letter.isascii() else _plain(letter)
        is_raised = unicodedata.decomposition(letter).startswith("<super>") and letter != "ᵀ"
        result.append("^" + plain if is_raised and not raised else plain)
        raised = is_raised
    return "".join(result)


def _plain(letter: str) -> str:
    for known in (letter, unicodedata.normalize("NFKC", letter)):
        if known in _SIGNS:
            return _SIGNS[known]
    parts = unicodedata.normalize("NFKD", letter)
    plain = "".join(_part(part) for part in parts)
    return plain if plain or all(map(unicodedata.combining, parts)) else _escape(letter)


def _part(letter: str) -> str:
    if letter.isascii() or letter in _SIGNS:
        return _SIGNS.get(letter, letter)
    if letter.lower() in _GREEK:
        name = _GREEK[letter.lower()]
        return name if letter.islower() else name.capitalize()
    return "" if unicodedata.combining(letter) else _escape(letter)


def escaped(text: str) -> str:
    """`text` on one line, with everything that a terminal could obey or hide written out."""
    return "".join(
        letter if letter.isprintable() or unicodedata.category(letter) == "Zs" else _escape(letter)
        for letter in text
    )


def _escape(letter: str) -> str:
    return (
        letter.encode("ascii", "backslashreplace").decode()
        if ord(letter) > 127
        else (letter.encode("unicode_escape").decode())
    )


def velocity_names(coordinates: Sequence[str]) -> tuple[str, ...]:
    """Names of the rates of coordinates."""
    return tuple(f"{name}_dot" for name in coordinates)
