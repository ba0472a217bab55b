"""Which effects are missing: candidates, the regression over them, search, acceptance, tests of the residuals."""
