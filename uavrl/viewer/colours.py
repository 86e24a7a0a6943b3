"""The colours of outcomes, states and things in pages and videos."""

OUTCOMES = {"arrived": "#009E73", "collided": "#D55E00", "timed_out": "#56B4E9"}  # colours of Okabe and Ito
ENDED = "#8b949e"
# Of the safety layer.
STATES = {"flying": "#009E73", "fenced": "#E69F00", "holding": "#D55E00", "standby": "#56B4E9", "silent": "#8b949e"}
# Of obstacles.
KINDS = {
    "tree": "#6b8f5e",
    "rock": "#8f8b84",
    "pole": "#a08a6a",
    "arch": "#9a7f72",
    "overhang": "#7f8794",
    "wall": "#b5ada0",
}
OTHER_KIND = "#8a8a8a"
PLANE, GOAL, SEEN, LED = "#7b3fa0", "#f0c419", "#d6006e", "#c2410c"
