"""Files in and out: Storage files of OpenSim."""

from scso_nlp.io.storage import Storage, read_storage, write_storage

__all__ = ["Storage", "read_storage", "write_storage"]
