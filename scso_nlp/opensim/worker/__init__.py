"""The OpenSim process: a model and a motion in, arrays out; the only package that imports ``opensim``.

OpenSim and CasADi cannot live in one process, so nothing here may lead to CasADi, and of this package only
:mod:`~scso_nlp.opensim.worker.exchange` may be imported from outside. `process` is what a worker runs. An
`Extraction` knows a `Model` (`coordinates`, `forces`, `bodies`, `skeleton`, `paths`, `muscles`), the
`Kinematics` of a motion, and turns any row of it into arrays: a `Pose` first, then what follows from it.

No analysis tools are used. Moment arms come from each path's equivalent body forces through the transposed
system Jacobian, net generalized forces from OpenSim's inverse dynamics, both reduced to the free coordinates
with du/du_free from the constraint matrix. Only second derivatives of path lengths are central differences,
of these moment arms.
"""
