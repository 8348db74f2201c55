"""What a solution is worth, in two lines: frames, stability, and what muscles do not carry themselves."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

# OpenSim's documentation, best practices, "Reserves and Residuals": 10 %, 10 to 20 N, 75 N·m.
#: Largest share of a coordinate's peak moment that its reserves should carry [-].
RESERVE_LIMIT = 0.10
#: Largest residual force and moment [N, N·m].
RESIDUAL_LIMITS = {"N": 20.0, "N·m": 75.0}
#: A margin nearer to zero is shown as zero: a row that is just kept [unit of the row].
ROUNDING = 1e-9
#: Statuses of frames that may be used.
USABLE = ("SOLVED", "STABILITY_MISSED", "ACCEPTABLE")
#: Statuses of all others.
UNUSABLE = ("INFEASIBLE", "LOCALLY_INFEASIBLE", "NOT_OPTIMAL", "ITERATION_LIMIT", "NUMERICAL_ERROR")


@dataclass(frozen=True, kw_only=True)
class Extreme:
    """The worst entry of a table over the solved frames.

    Attributes
    ----------
    name : str
        Row or coordinate.
    time : float [s]
    amount : float [unit]
    unit : str
    """

    name: str
    time: float
    amount: float
    unit: str

    def __str__(self) -> str:
        return f"{self.amount:.4g} {self.unit} ({self.name} at t = {self.time:.6g} s)"


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """What a solution is worth.

    Attributes
    ----------
    counts : dict of str to int
        Frames by status, worst last.
    n_frames : int
    margin : Extreme or None
        Least margin of the stability rows, and smallest eigenvalue less its levels; None without rows.
    frames_stable : int or None
        Solved frames in which every stability row keeps its level, soft and observed ones too; None without
        rows.
    missed : Extreme or None
        Largest miss of a soft level; None where none is missed.
    frames_missed : int
        Frames in which a soft level is missed.
    reserve : Extreme or None
        Largest share that actuators carry of a coordinate's peak moment, where muscles act too [%].
    residual_force, residual_moment : Extreme or None
        Largest force and moment of actuators by which the model floats: on coordinates of a joint that may
        both turn and shift against ground, and that no muscle moves.
    motor_force, motor_moment : Extreme or None
        Largest force and moment of actuators on all other coordinates that no muscle moves.
    effort : dict of str to float
        The objective over the solved frames by what it is paid for: muscles, other actuators, misses of soft
        levels at their price, other terms [-].
    """

    counts: dict[str, int]
    n_frames: int
    margin: Extreme | None
    missed: Extreme | None
    frames_missed: int
    reserve: Extreme | None
    residual_force: Extreme | None
    residual_moment: Extreme | None
    motor_force: Extreme | None = None
    motor_moment: Extreme | None = None
    frames_stable: int | None = None
    effort: dict[str, float] = field(default_factory=dict)

    @property
    def is_clean(self) -> bool:
        """True if every frame is solved to the tolerance asked for and misses no level."""
        return set(self.counts) <= {"SOLVED"}

    @property
    def others(self) -> str:
        """Name all statuses but SOLVED with their numbers of frames."""
        found = ((status.lower().replace("_", " "), n) for status, n in self.counts.items())
        return ", ".join(f"{n} {status}" for status, n in found if status != "solved")

    @property
    def beyond_limits(self) -> tuple[str, ...]:
        """What is above OpenSim's limits, one phrase each."""
        found = []
        if self.reserve is not None and self.reserve.amount > 100 * RESERVE_LIMIT:
            found.append(f"reserves above {100 * RESERVE_LIMIT:g} % of a peak moment")
        for what, residual in (("force", self.residual_force), ("moment", self.residual_moment)):
            if residual is not None and residual.amount > RESIDUAL_LIMITS[residual.unit]:
                found.append(f"a residual {what} above {RESIDUAL_LIMITS[residual.unit]:g} {residual.unit}")
        return tuple(found)

    def lines(self, baseline: Verdict | None = None) -> tuple[str, str]:
        """Say it in two lines.

        Parameters
        ----------
        baseline : Verdict, optional
            Of the same motion without stability rows: where reserves grow beyond the limit with them, that is
            said.

        Returns
        -------
        frames, stability and effort; reserves, residuals and motors : str
        """
        counts = ", ".join(
            f"{n} {status.lower().replace('_', ' ')}"
            for status, n in self.counts.items()
            if status != "SOLVED"
        )
        first = f"{self.counts.get('SOLVED', 0)} of {self.n_frames} frames solved"
        first += f" ({counts})" if counts else ""
        if self.frames_stable is not None and any(status in self.counts for status in USABLE):
            first += f"; stable in {self.frames_stable}"
        if self.missed is not None:
            first += f"; levels missed in {self.frames_missed} frames, most by {self.missed}"
        if self.margin is not None:
            margin = self.margin
            if abs(margin.amount) < ROUNDING:
                margin = replace(margin, amount=0.0)
            first += f"; least margin {margin}"
        paid = ", ".join(f"{amount:.4g} of {what}" for what, amount in self.effort.items() if amount)
        first += f"; effort {paid}" if paid else ""
        second = "no reserves"
        if not any(status in self.counts for status in USABLE):
            second = "no frame is solved, so nothing is known of reserves"
        elif self.reserve is not None:
            worst = self.reserve
            second = (
                f"reserves carry at most {worst.amount:.4g} % of a peak moment "
                f"({worst.name} at t = {worst.time:.6g} s)"
            )
        for what, force, moment in (
            ("residuals", self.residual_force, self.residual_moment),
            ("motors", self.motor_force, self.motor_moment),
        ):
            found = " and ".join(str(extreme) for extreme in (force, moment) if extreme is not None)
            second += f"; {what} at most {found}" if found else ""
        if self.beyond_limits:
            second += f"; OpenSim advises against {', '.join(self.beyond_limits)}"
        if self._is_bought(baseline):
            second += "; stability is bought from reserves"
        return first, second

    def _is_bought(self, baseline: Verdict | None) -> bool:
        if baseline is None or baseline.reserve is None or self.reserve is None:
            return False
        limit = 100 * RESERVE_LIMIT
        return self.reserve.amount > limit and self.reserve.amount > baseline.reserve.amount + limit
