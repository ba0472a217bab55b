"""Candidates, and the regression over them: of residuals, their noise and the gust."""
