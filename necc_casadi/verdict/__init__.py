"""Whether a target can be assigned (eq. LocalMinimumCondition), decided exactly."""
