"""OpenSim as an engine: setup files and motions in, frozen arrays out, each run in processes of its own."""
