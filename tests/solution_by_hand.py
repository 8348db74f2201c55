"""Solutions made without a solver, for tests of what comes after it."""

import numpy as np
from helpers import muscle_parameters

from scso_nlp import ActivationEffort, JointStability, MomentEquilibrium, NoPhysiology
from scso_nlp.constraints.stability_constraint import STABILITY_SCALE
from scso_nlp.motion import Motion
from scso_nlp.muscles import ActuatorParameters
from scso_nlp.problem import MuscleForceProblem
from scso_nlp.report.results import write_solution
from scso_nlp.solution import InfeasibilityProof, Shortfall, SolveReport, Status
from scso_nlp.solver.feasibility import Impossible
from scso_nlp.solver.judge import Outcome, judge
from scso_nlp.trajectory import MotionTrajectory, Skeleton
from scso_nlp.transcription.describe import describe

#: Moment arms of two antagonists about one axis [m].
ARM = 0.05
STRENGTH = 1000.0
OPTIMAL_FORCE = 10.0


def antagonists(n_frames=5, name="antagonists", n_pairs=1, sides=("front", "back")):
    """One hinge about z per pair; each muscle runs straight from (±0.05, -0.05, 0) to (±0.05, 0.05, 0)."""
    coordinates = tuple(f"hinge_{i}" for i in range(n_pairs))
    muscles = tuple(f"{side}_{i}" for i in range(n_pairs) for side in sides)
    actuators = tuple(f"{c}_reserve" for c in coordinates)
    n_muscles = len(muscles)
    points = np.zeros((n_frames, n_muscles, 2, 3))
    points[:, :, 0, 1], points[:, :, 1, 1] = -ARM, ARM
    points[:, 0::2, :, 0], points[:, 1::2, :, 0] = ARM, -ARM
    bodies = ("ground", *(f"body_{i}" for i in range(n_pairs)))
    path_bodies = np.zeros((n_frames, n_muscles, 2), dtype=int)
    for m in range(n_muscles):
        path_bodies[:, m, 1] = 1 + m // 2
    skeleton = Skeleton(
        bodies=bodies,
        body_parents=[-1, *([0] * n_pairs)],
        body_masses=[0.0, *([0.0] * n_pairs)],
        body_mass_centers=np.zeros((n_frames, len(bodies), 3)),
        gravity=(0.0, -9.81, 0.0),
        joints=coordinates,
        joint_children=np.arange(1, n_pairs + 1),
        joint_centers=np.zeros((n_frames, n_pairs, 3)),
        joint_axes=np.broadcast_to(np.eye(3), (n_frames, n_pairs, 3, 3)),
        load_names=(),
        load_bodies=np.zeros(0, dtype=int),
        load_forces=np.zeros((n_frames, 0, 3)),
        load_points=np.zeros((n_frames, 0, 3)),
        load_torques=np.zeros((n_frames, 0, 3)),
        path_points=points,
        path_point_bodies=path_bodies,
        path_point_moves=np.zeros(path_bodies.shape, dtype=bool),
    )
    time = np.linspace(0.0, 1.0, n_frames) if n_frames > 1 else np.zeros(1)
    arms = np.zeros((n_frames, n_pairs, n_muscles))
    for i in range(n_pairs):
        arms[:, i, 2 * i], arms[:, i, 2 * i + 1] = -ARM, ARM
    phase = np.arange(n_pairs)
    moments = 5.0 * np.sin(2 * np.pi * time[:, None] + phase)
    generalized = np.zeros((n_frames, n_pairs, n_pairs))
    generalized[:] = OPTIMAL_FORCE * np.eye(n_pairs)
    loads = np.column_stack([np.full(n_frames, 2.0), np.arange(n_frames) * 1.0])
    trajectory = MotionTrajectory(
        name=name,
        muscles=muscles,
        actuators=actuators,
        coordinates=coordinates,
        is_rotational=[True] * n_pairs,
        time=time,
        coordinate_values=np.zeros((n_frames, n_pairs)),
        coordinate_speeds=np.zeros((n_frames, n_pairs)),
        muscle_tendon_length=np.full((n_frames, n_muscles), 2 * ARM),
        muscle_tendon_velocity=np.zeros((n_frames, n_muscles)),
        moment_arms=arms,
        actuator_generalized_forces=generalized,
        generalized_forces=moments,
        passive_generalized_forces=np.zeros((n_frames, n_pairs)),
        active_force_capacity=np.full((n_frames, n_muscles), STRENGTH),
        force_columns=(actuators[0], *muscles, *actuators[1:], "hand_load_Fx", "hand_load_Fy"),
        other_force_labels=("hand_load_Fx", "hand_load_Fy"),
        other_forces=loads,
        skeleton=skeleton,
    )
    unlimited = np.full(n_pairs, np.inf)
    parameters = ActuatorParameters(
        actuators=actuators,
        optimal_force=np.full(n_pairs, OPTIMAL_FORCE),
        min_control=-unlimited,
        max_control=unlimited,
    )
    return Motion(trajectory=trajectory, muscles=muscle_parameters(muscles, STRENGTH), actuators=parameters)


def out_of_reach(frame, time, coordinate):
    """What says that 3.1 N·m are asked for and nothing pulls."""
    return InfeasibilityProof(
        frame=frame,
        frames=(frame,),
        time=time,
        constraints=("MomentEquilibrium",),
        rows=(coordinate,),
        units=("N·m",),
        turns=(np.zeros(0),),
        multipliers=np.ones(1),
        matrix=np.zeros((1, 0)),
        row_lower=np.array([3.1]),
        row_upper=np.array([3.1]),
        size=np.array([3.1]),
        unknowns=(),
        lower=np.zeros(0),
        upper=np.zeros(0),
    )


def solution_by_hand(
    n_frames=5,
    *,
    failed=(),
    stability=True,
    name="antagonists",
    n_pairs=1,
    level=10.0,
    tonus=0.05,
    sides=("front", "back"),
):
    """Muscles take nine tenths of the moment above a co-contraction of `tonus`; reserves the rest."""
    motion = antagonists(n_frames, name, n_pairs, sides)
    trajectory = motion.trajectory
    constraints = (MomentEquilibrium(),)
    if stability:
        constraints += (JointStability(q=5.0, level=level, axes=("z",)),)
    problem = MuscleForceProblem(
        motion=motion,
        muscle_model=NoPhysiology(),
        objectives=(ActivationEffort(exponent=2.0),),
        constraints=constraints,
    )
    moments = trajectory.generalized_forces
    activation = np.zeros((n_frames, 2 * n_pairs))
    share = 0.9 * moments / (ARM * STRENGTH)
    activation[:, 1::2] = tonus + np.maximum(share, 0)
    activation[:, 0::2] = tonus + np.maximum(-share, 0)
    control = 0.1 * moments / OPTIMAL_FORCE
    program = describe(problem)
    # the solver's signs: negative where a lower bound pushes, and the other way round for equations
    multipliers = np.full((n_frames, len(program.rows)), -0.1)
    if stability:
        multipliers[:, n_pairs:] = 0.0
        multipliers[0, n_pairs:] = -0.25 * STABILITY_SCALE
    impossible = tuple(
        Impossible(
            proof=out_of_reach(k, float(trajectory.time[k]), trajectory.coordinates[0]),
            shortfalls=(
                Shortfall(
                    frame=k,
                    time=float(trajectory.time[k]),
                    constraint="MomentEquilibrium",
                    row=trajectory.coordinates[0],
                    amount=3.1,
                    unit="N·m",
                    proven=True,
                    helpers=("back_0",),
                ),
            ),
        )
        for k in failed
    )
    outcome = Outcome(
        program=program,
        unknowns=np.hstack([activation, control]),
        multipliers=(multipliers, np.zeros((n_frames - 1, 0))),
        status=tuple(Status.INFEASIBLE if k in failed else Status.SOLVED for k in range(n_frames)),
        impossible=impossible,
    )
    report = SolveReport(
        solver="framewise",
        iterations=7 * n_frames,
        build_seconds=0.1,
        solve_seconds=0.2,
        options={"tolerance": 1e-6, "max_iterations": 500},
        versions={"scso_nlp": "0.1.0", "casadi": "3.8.2"},
    )
    return judge(outcome, report, is_graded=False)


def write(solution, folder, **options):
    """Write the result files of a solution, without figures unless they are asked for."""
    return write_solution(solution, folder, **{"figures": False, **options})
