"""OpenSim's JointReaction at given forces, in a process of its own.

Usage: python opensim_joint_reaction.py QUESTION, which is JSON:

setup, results
    AnalyzeTool's setup file, and a folder.
forces
    Storage file with the force of every actuator of the model.
places
    Pairs of a body, child or parent, and a frame, ground, child or parent: each is a file of all joints.
step
    Every so many rows of the motion.
"""

import json
import sys

import opensim


def answer(question):
    """Run the tool with JointReaction in place of its own analyses."""
    tool = opensim.AnalyzeTool(question["setup"])
    model = tool.getModel()
    for i in range(model.getAnalysisSet().getSize()):
        model.getAnalysisSet().get(i).setOn(False)
    for on, frame in question["places"]:
        analysis = opensim.JointReaction(model)
        analysis.setName(f"{on}_{frame}")
        analysis.setForcesFileName(question["forces"])
        analysis.setStepInterval(question["step"])
        for choose, word in (
            (analysis.setJointNames, "ALL"),
            (analysis.setOnBody, on),
            (analysis.setInFrame, frame),
        ):
            words = opensim.ArrayStr()
            words.append(word)
            choose(words)
        model.addAnalysis(analysis)
    tool.setResultsDir(question["results"])
    # 8 digits after the point by default
    tool.setOutputPrecision(12)
    tool.run()


if __name__ == "__main__":
    opensim.Logger.setLevelString("Error")
    answer(json.loads(sys.argv[1]))
