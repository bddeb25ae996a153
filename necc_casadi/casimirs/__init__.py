"""Casimirs of the closed loop (eq. CasimirCondition, CasimirConditionFunctionCase)."""
