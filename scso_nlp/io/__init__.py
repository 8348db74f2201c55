"""Files in and out: Storage files of OpenSim, and bundles of extracted motions."""

from scso_nlp.io.bundle import Provenance, load_bundle, read_provenance, save_bundle
from scso_nlp.io.storage import Storage, read_storage, write_storage

__all__ = [
    "Provenance",
    "Storage",
    "load_bundle",
    "read_provenance",
    "read_storage",
    "save_bundle",
    "write_storage",
]
