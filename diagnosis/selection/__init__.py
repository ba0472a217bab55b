"""Which effects are missing: candidates, the regression over them, search, rivals, tests of the residuals."""
