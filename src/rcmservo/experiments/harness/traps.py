"""The pitfalls of the project's critical reading of the paper, and the claims that meet them."""

from dataclasses import dataclass

from rcmservo.experiments.harness.rows import ClaimRow

TRAPS = {
    "T0": "errata: as printed, the gradient of (32) drops from b to b/2",
    "T1": "nothing can be inverted at Ĵ(0) = 0, â(0) = 0; and success does not show that Ĵ is "
    "right",
    "T2": "λ is not constant on a real tool",
    "T3": "singular poses: judge the scaled condition, not the determinant",
    "T4": "spherical coordinates are singular at θ = 0",
    "T5": "the gains fit mm and px: k = 0.1 with b = 10 is 1 px/s",
    "T6": "the printed Γ is a slow solver",
    "T7": "γ = 0.001 learns by 1 − exp(−γ v L): hardly at 1 mm/s",
    "T8": "the last H lines of a slow motion are almost one line",
    "T9": "six observations are neither needed nor enough: coplanar ones have rank 8",
    "T10": "a wrong zero of ρ breaks c₁₄ = c₂₄ = 0",
    "T11": "the angle wraps",
    "T12": "60 frames/s in a 100 Hz loop: repeated frames bias ẏ",
    "T13": "pixel noise is large against 1 px/s",
    "T14": "a ball's centroid is not its centre's image",
    "T15": "(33) assumes J Ĵ⁻¹ = I; stability needs its symmetric part positive definite",
    "T16": "ambiguities: which marker, which m, how 4 mm was measured",
    "T17": "what 4 mm means: a few mm of pose per pixel",
}
"""The traps of the project's critical reading of the paper, in a few words."""


@dataclass(frozen=True)
class Trap:
    """A pitfall and the claims that meet it."""

    name: str
    """T0, T1, ..., a key of TRAPS."""
    words: str
    """What it is, as TRAPS has it."""
    rows: list[ClaimRow]
    """The claims that meet it, in the order of the report."""

    @property
    def verdict(self) -> str:
        """Whether the numbers confirm it; few trials cannot tell."""
        told = [row.trap_confirmed for row in self.rows if row.trap_confirmed is not None]
        if not told:
            return "too few trials to tell"
        return "confirmed" if all(told) else "refuted"


def traps_met(rows: list[ClaimRow]) -> list[Trap]:
    """The pitfalls that some claim meets, in their order."""
    traps = [Trap(name, TRAPS[name], [r for r in rows if r.trap == name]) for name in TRAPS]
    return [trap for trap in traps if trap.rows]
