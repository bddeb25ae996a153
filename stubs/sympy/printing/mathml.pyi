from typing import Any

from sympy import Basic

class MathMLPresentationPrinter:
    def __init__(self, settings: dict[str, Any] | None = None) -> None: ...
    def doprint(self, expr: Basic) -> str: ...
