"""OpenSim's static optimization, and the problem that it solves, from OpenSim alone, in a process of its own.

Usage: python opensim_static_optimization.py QUESTION, which is JSON:

setup, results, unfiltered
    AnalyzeTool's setup file, a folder, and whether to leave the low-pass filter out.
criterion, iterations, step
    Of StaticOptimization, where they are not those of the setup.
times, actuators, problem
    Instead of an answer: the file to write the problem to that StaticOptimization has at these times.

The problem is made of OpenSim's calls only, in the order of its StaticOptimizationTarget: coordinates and
speeds of AnalyzeTool's states, assembled; accelerations wanted are derivatives of the splines through these
speeds; accelerations that a unit of each actuator adds are forward dynamics with overridden actuation.
"""

import json
import os
import sys

import numpy as np
import opensim


def load(question):
    """Return a tool with its StaticOptimization and nothing else to do."""
    tool = opensim.AnalyzeTool(question["setup"])
    tool.setResultsDir(question["results"])
    tool.setOutputPrecision(17)
    if question["unfiltered"]:
        tool.setLowpassCutoffFrequency(-1)
    analyses, found = tool.getModel().getAnalysisSet(), None
    for i in range(analyses.getSize()):
        analysis = opensim.StaticOptimization.safeDownCast(analyses.get(i))
        if analysis is None:
            analyses.get(i).setOn(False)
        else:
            found = analysis
    return tool, found


def answer(question):
    """Run the tool; it writes its files and says on its log how it went."""
    opensim.Logger.setLevelString("Info")
    tool, analysis = load(question)
    if "criterion" in question:
        analysis.setConvergenceCriterion(question["criterion"])
        analysis.setMaxIterations(question["iterations"])
        analysis.setStepInterval(question["step"])
    tool.run()


def prepared_states(question):
    """Return AnalyzeTool's states: times, columns by name, and the splines through them with their order."""
    tool, analysis = load(question)
    analysis.setOn(False)
    tool.setPrintResultFiles(False)
    tool.run()
    storage, column = tool.getStatesStorage(), opensim.ArrayDouble()
    labels, columns = storage.getColumnLabels(), {}
    storage.getTimeColumn(column)
    time = column.getAsVector().to_numpy().copy()
    for i in range(labels.getSize() - 1):
        storage.getDataColumn(i, column)
        columns[labels.get(i + 1)] = column.getAsVector().to_numpy().copy()
    return time, columns, opensim.GCVSplineSet(5, storage)


def problem(question):
    """Write matrices (n_times, n_free, n_actuators), right sides and the motion's accelerations, each row."""
    time, columns, splines = prepared_states(question)
    tool, analysis = load(question)
    model = tool.getModel()
    os.chdir(os.path.dirname(question["setup"]))
    if tool.getExternalLoadsFileName():
        loads = opensim.ExternalLoads(tool.getExternalLoadsFileName(), True)
        loads.this.disown()
        model.addModelComponent(loads)
    state = model.initSystem()
    model.setAllControllersEnabled(False)
    forces = [model.getForceSet().get(name) for name in question["actuators"]]
    actuators = [opensim.ScalarActuator.safeDownCast(force) for force in forces]
    muscles = [opensim.Muscle.safeDownCast(force) for force in forces]
    coordinates = coordinates_in_tree_order(model)
    free = [(c, path) for c, path in coordinates if not c.isConstrained(state)]
    where = list(columns)
    rows = [int(np.abs(time - t).argmin()) for t in question["times"]]
    matrices, wanted, motion = [], [], []
    for row in range(min(rows), max(rows) + 1):
        # one after the other, as AnalyzeTool does: the assembly begins at the pose before
        state.setTime(float(time[row]))
        for actuator in actuators:
            actuator.overrideActuation(state, False)
        for coordinate, path in coordinates:
            if not coordinate.getLocked(state):
                coordinate.setValue(state, float(columns[path + "/value"][row]), False)
            coordinate.setSpeedValue(state, float(columns[path + "/speed"][row]))
        model.assemble(state)
        if row not in rows:
            continue
        model.realizeVelocity(state)
        unit = [
            actuator.getOptimalForce()
            if muscle is None
            else muscle.calcInextensibleTendonActiveFiberForce(state, 1.0)
            if analysis.getUseMusclePhysiology()
            else muscle.getMaxIsometricForce()
            for actuator, muscle in zip(actuators, muscles, strict=True)
        ]
        for actuator in actuators:
            actuator.overrideActuation(state, True)
        without = accelerations(model, state, actuators, np.zeros(len(unit)), free)
        effects = [accelerations(model, state, actuators, force, free) - without for force in np.diag(unit)]
        matrices.append(np.stack(effects, axis=1))
        aims = [splines.evaluate(where.index(path + "/speed"), 1, float(time[row])) for _, path in free]
        motion.append(aims)
        wanted.append(np.array(aims) - without)
    np.savez(
        question["problem"],
        time=time[rows],
        matrices=np.array(matrices),
        wanted=np.array(wanted),
        accelerations=np.array(motion),
        lower=[actuator.getMinControl() for actuator in actuators],
        upper=[actuator.getMaxControl() for actuator in actuators],
    )


def coordinates_in_tree_order(model):
    """Return all coordinates with their paths."""
    found = model.getCoordinateSet()
    by_path = {found.get(i).getAbsolutePathString(): found.get(i) for i in range(found.getSize())}
    paths = [
        path.removesuffix("/value")
        for path in opensim.createStateVariableNamesInSystemOrder(model)
        if path.endswith("/value")
    ]
    return [(by_path[path], path) for path in paths]


def accelerations(model, state, actuators, forces, free):
    """Return the accelerations of the free coordinates with these forces of the actuators."""
    for actuator, force in zip(actuators, forces.tolist(), strict=True):
        actuator.setOverrideActuation(state, force)
    model.realizeAcceleration(state)
    return np.array([coordinate.getAccelerationValue(state) for coordinate, _ in free])


if __name__ == "__main__":
    asked = json.loads(sys.argv[1])
    # else the log is written beside the setup
    opensim.Logger.addFileSink(os.path.join(asked["results"], "opensim.log"))
    problem(asked) if "problem" in asked else answer(asked)
