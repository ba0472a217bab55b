"""Colours of all pictures: Okabe and Ito's for the colour-blind, and what they become on a dark page."""

from __future__ import annotations

from collections.abc import Mapping

BLACK, ORANGE, SKY, GREEN, YELLOW, BLUE, VERMILION, PURPLE = (
    "#000000",
    "#E69F00",
    "#56B4E9",
    "#009E73",
    "#F0E442",
    "#0072B2",
    "#D55E00",
    "#CC79A7",
)
MEASURED, BEFORE, AFTER, FLOOR = BLACK, VERMILION, BLUE, "#6b7280"
GRID, UNFLOWN, SPACE_GRID, AXIS = "#e5e7eb", "#d4d8de", "#d1d5db", "#9ca3af"
TEXT, PAPER = "#1c2430", "#ffffff"

# light to dark, one to one: what is dark on paper becomes light, by 3 to 1 or more on the dark page
DARK: Mapping[str, str] = {
    BLACK: "#f4f6f9",
    BLUE: "#3f9ad9",
    SKY: "#a5d8f7",
    FLOOR: "#9aa4b2",
    AXIS: "#66707e",
    GRID: "#2b3440",
    SPACE_GRID: "#3a4553",
    UNFLOWN: "#3d4754",
    TEXT: "#e6eaf0",
    PAPER: "#12171e",
}
