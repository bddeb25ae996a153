"""Axes that read like a data sheet: powers of a thousand beside the unit, short ticks."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import Formatter, FuncFormatter, LogLocator, MaxNLocator, NullFormatter

from necc_casadi.report.style import Drawing

__all__ = [
    "engineering",
    "finished",
    "logarithmic",
    "no_finer",
    "panels",
    "power_of",
    "rounded",
    "scaled_label",
]


#: Powers of ten between which numbers stand as they are; with a unit that takes a prefix, from one
#: higher on.
_PLAIN_LOW, _PLAIN_HIGH = -2, 4


#: Prefixes, and the units that take one.
_PREFIXES = {
    -15: "f", -12: "p", -9: "n", -6: "µ", -3: "m", 3: "k", 6: "M", 9: "G", 12: "T",
}  # fmt: skip
_TAKES_PREFIX = {
    "m", "s", "A", "V", "W", "N", "Pa", "J", "C", "F", "H", "Hz", "T", "Wb", "rad", "N m", "m/s",
    "rad/s", "V s", "A s", "N s",
}  # fmt: skip


#: Digits on a tick beyond which what all ticks share is written once, as an offset.
_MOST_DIGITS = 5


#: Ticks on an axis at most.
_TICKS = 6


#: Inches around panels: left for a label and ticks, right, between rows; above and below.
_LEFT, _RIGHT, _BETWEEN, _ABOVE, _BELOW = 0.8, 0.15, 0.6, 0.45, 0.55


def panels(
    rows: int,
    columns: int,
    panel: tuple[float, float],
    legend: float = 0.0,
    above: float = 0.0,
) -> Figure:
    """A figure with room for panels of a width and a height in inches, and for a legend below.

    `above` is room for more than two lines of a title.

    A layout that measures every text takes longer than all the drawing.
    """
    width = columns * (_LEFT + panel[0] + _RIGHT)
    below = _BELOW + legend
    height = _ABOVE + above + rows * panel[1] + (rows - 1) * _BETWEEN + below
    figure = Drawing(figsize=(width, height))
    figure.subplots_adjust(
        left=_LEFT / width,
        right=1 - _RIGHT / width,
        bottom=below / height,
        top=1 - (_ABOVE + above) / height,
        wspace=(_LEFT + _RIGHT) / panel[0],
        hspace=_BETWEEN / panel[1],
    )
    return figure


def rounded(value: float, digits: int = 3) -> str:
    """A number from a tenth to a few thousands in so many digits, without an exponent.

    Whole numbers keep all of theirs.
    """
    if not 0 < abs(value) < math.inf:
        return f"{value:g}"
    decimals = max(0, digits - 1 - math.floor(math.log10(abs(value))))
    text = f"{value:.{decimals}f}"
    text = text.rstrip("0").rstrip(".") if "." in text else text
    return text.replace("-", "−")


def power_of(largest: float, unit: str = "") -> int:
    """The power of a thousand in which the largest magnitude is 1 to 1000; 0: as it stands."""
    if not largest > 0 or not math.isfinite(largest):
        return 0
    exponent = math.floor(math.log10(largest) + 1e-9)
    if _PLAIN_LOW + (unit in _TAKES_PREFIX) <= exponent < _PLAIN_HIGH:
        return 0
    return 3 * math.floor(exponent / 3)


_SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def scaled_label(label: str, unit: str, power: int) -> str:
    """The label with its unit in a power of ten: ``q [µm]``, ``p [10⁻¹² kg m/s]``."""
    if power == 0:
        return f"{label} [{unit}]" if unit else label
    if unit in _TAKES_PREFIX and power in _PREFIXES:
        return f"{label} [{_PREFIXES[power]}{unit}]"
    factor = f"10{str(power).translate(_SUPERSCRIPT)}"
    return f"{label} [{factor} {unit}]" if unit else f"{label} [{factor}]"


def engineering(value: float, unit: str = "", digits: int = 3) -> str:
    """A number with its unit: ``3 µm``, ``1.19·10⁸ kg m/s``."""
    power = power_of(abs(value), unit)
    number = rounded(value / 10.0**power, digits)
    if power == 0:
        return f"{number} {unit}".rstrip()
    if unit in _TAKES_PREFIX and power in _PREFIXES:
        return f"{number} {_PREFIXES[power]}{unit}"
    return f"{number}·10{str(power).translate(_SUPERSCRIPT)} {unit}".rstrip()


class _Scaled(Formatter):
    """Ticks over a power of ten, with as many digits as tell them apart."""

    def __init__(self, power: int) -> None:
        self._factor = 10.0**power
        self._digits, self._offset, self._offset_text, self._inner = 0, 0.0, "", 1.0

    def set_locs(self, locs: Any) -> None:
        """Choose digits and offset for these ticks."""
        values = sorted(float(v) / self._factor for v in locs)
        self._digits, self._offset, self._offset_text, self._inner = 0, 0.0, "", 1.0
        if len(values) < 2 or not values[-1] > values[0]:
            return
        step = min(b - a for a, b in pairwise(values) if b > a)
        self._digits = _decimals(step)
        whole = len(str(int(max(abs(values[0]), abs(values[-1])))))
        if whole + self._digits > _MOST_DIGITS:
            self._offset = values[0]
            power = power_of(values[-1] - values[0])
            self._inner = 10.0**power
            factor = f"·10{str(power).translate(_SUPERSCRIPT)} " if power else ""
            self._offset_text = f"{factor}{self._offset:+.{self._digits}f}".replace("-", "−")
            self._digits = _decimals(step / self._inner)

    def get_offset(self) -> str:
        """What every tick is multiplied by, and what is added to it, if anything."""
        return self._offset_text

    def __call__(self, x: float, pos: int | None = None) -> str:
        """The text of one tick."""
        value = (x / self._factor - self._offset) / self._inner
        text = f"{value:.{self._digits}f}"
        return text.replace("-", "−") if float(text) else text.replace("-", "")


def _decimals(step: float) -> int:
    """Digits behind the point that tell ticks apart."""
    digits = max(0, -math.floor(math.log10(step) + 1e-6))
    return digits if _is_round(step, digits) else digits + 1


def power_of_ten(value: float, _pos: int | None = None) -> str:
    """A tick of a logarithmic axis, without a typesetter of mathematics: ``10⁻¹²``."""
    exponent = round(math.log10(value)) if value > 0 else 0
    return f"10{str(exponent).translate(_SUPERSCRIPT)}"


def logarithmic(axes: Axes, side: str) -> None:
    """Ticks at powers of ten on one side."""
    axis = getattr(axes, f"{side}axis")
    axis.set_major_locator(LogLocator(10, numticks=_TICKS))
    axis.set_major_formatter(FuncFormatter(power_of_ten))
    axis.set_minor_formatter(NullFormatter())


def _is_round(step: float, digits: int) -> bool:
    shifted = step * 10.0**digits
    return math.isclose(shifted, round(shifted), rel_tol=1e-6)


def no_finer(axes: Axes, span: float, middle: float, room: float) -> None:
    """Where what is drawn spans less than `span`, it is no motion: show `room` on either side."""
    low, high = axes.get_ylim()
    if high - low < span:
        axes.set_ylim(middle - room, middle + room)


def finished(axes: Axes, sides: Sequence[tuple[str, str, str]]) -> None:
    """Labels and ticks of linear sides, (``x``, label, unit) each, once limits are known."""
    for side, label, unit in sides:
        low, high = getattr(axes, f"get_{side}lim")()
        power = power_of(max(abs(low), abs(high)), unit)
        getattr(axes, f"set_{side}label")(scaled_label(label, unit, power))
        axis = getattr(axes, f"{side}axis")
        axis.set_major_locator(MaxNLocator(_TICKS, steps=[1, 2, 2.5, 5, 10]))
        axis.set_major_formatter(_Scaled(power))
