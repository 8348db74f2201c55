"""Fetch third-party data of the problems on first use; nothing of it is part of this repository.

Each data set is pinned: repository, commit and the SHA-256 of every file. Files are taken from the folder
that the environment variable ``SCSO_DATA`` names, or from a cache folder, or from the network, in this order.
"""

from __future__ import annotations

import logging
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import quote

from scso_nlp.exceptions import DataError
from scso_nlp.files import sha256

#: Folder with local copies of the data sets, one folder each.
LOCAL_COPY = "SCSO_DATA"
#: Folder that keeps what OpenSim has computed from the motions, so that it need not run twice.
MOTION_CACHE = "SCSO_CACHE"
#: Where the pinned files are, unless told otherwise.
BASE_URL = "https://raw.githubusercontent.com"
#: How long a server may stay silent [s].
TIMEOUT = 30.0


@dataclass(frozen=True, kw_only=True)
class DataSet:
    """Files of one data set and where they come from.

    Attributes
    ----------
    name : str
        Folder of the data set below ``SCSO_DATA`` and in the cache.
    repository, commit, folder : str
        GitHub repository, full commit hash and folder within it.
    license : str
    files : mapping of str to str
        SHA-256 by path, relative to the data set's folder.
    origins : mapping of str to str
        Path within `folder` of files that are called differently there.
    """

    name: str
    repository: str
    commit: str
    folder: str
    license: str
    files: Mapping[str, str]
    origins: Mapping[str, str]

    def url(self, file: str, base_url: str = BASE_URL) -> str:
        """Give the address of one file.

        Parameters
        ----------
        file : str
            One of `files`.
        base_url : str

        Returns
        -------
        str
        """
        path = "/".join(part for part in (self.folder, self.origins.get(file, file)) if part)
        return f"{base_url}/{self.repository}/{self.commit}/{quote(path)}"


_OPENSIM = {
    "repository": "opensim-org/opensim-core",
    "commit": "0435b081dc383498e217f92ca63bb97616145c14",
    "license": "Apache-2.0",
}

GAIT10DOF18MUSC = DataSet(
    name="gait10dof18musc",
    **_OPENSIM,
    folder="Bindings/Python/tutorials/resources/Tutorial 6",
    files={
        "gait10dof18musc_Strong_actuators.xml": (
            "97675c7d5785a9807e3228a908c65df931ea053896f0a981aa986acd43355f67"
        ),
        "gait10dof18musc_simbody.osim": "e8725518aa7d2be03005c31006305bd24c2ee7af230366c09305c6bd586148b3",
        "subject01_walk_IK.mot": "10a3877abacf8c35049532d018b2bdfac7623234c8f1ce9f7a68f007f2c7c976",
        "subject01_walk_grf.mot": "c3b5b46c64e958832f402687c328ca0f6fe132ebd8ccdf613600c5422d4a2a81",
        "subject01_walk_grf.xml": "307816039e06346094cb0b0d0d6d176935761c02c9fef34a17cfbd57a7882d22",
    },
    origins={},
)

WALKING3D = DataSet(
    name="walking3d",
    **_OPENSIM,
    folder="OpenSim/Examples/Moco/example3DWalking",
    files={
        "coordinates.sto": "981e94b5d7bb6fcae403a381fee8c3011533d8c683b17460096b400d20044cdb",
        "electromyography.sto": "0746a08b1107f816ef35183d7639ca46dc863b60e178404d822ddc42fbb58061",
        "grf_walk.mot": "372d59855f80d7de81303cb7d3a5c5878ef8e0cb82a53a27cfce44e93357e42c",
        "grf_walk.xml": "3c5313d5680c52fd130a0ed86620472fe3c576a5a9599ed08a53652b84dd82e6",
        "subject_walk_scaled.osim": "806ad1b248c6b2bc48ab43b58865915d1664e144b4ff6846457d80adacc23ce5",
        "subject_walk_scaled_FunctionBasedPathSet.xml": (
            "932ac403e4d6d0d10d9a9da551e43d0ded94dd2b99c370f9b25053ee9232f8a5"
        ),
    },
    origins={},
)

_LIFTS = {
    "stoop15kg/emgFilt.sto": "0c258c920f9f0bed7a19652881b47e059c757e1bd9aebe69d7d8c43b8e40eb7b",
    "stoop15kg/id.sto": "4cf07e9c18d61d0332251d95f95c61812c275bbc45e4750e4b7e636b724caeb9",
    "stoop15kg/ik.sto": "d77304af412ad7b78eb5fd12a336a4c22f8b735d55d60c5f7d267e6845bdbdbd",
    "stoop5kg/emgFilt.sto": "9501c78406106f8dd63804f018d3acc61a706a65769599e884898d692feec498",
    "stoop5kg/id.sto": "b29ab157beec47129566bb74827a97f7927b6f2de355006a669a29cf7a8cc2d3",
    "stoop5kg/ik.sto": "9f5fd42d02c67332f1d3af1c734ca8c927bcafba50878d05059a9bdb7d504aa9",
}

BACK_LIFTING = DataSet(
    name="back_lifting",
    repository="CEINMS-RT/BackModel",
    commit="ca4cbcb9736dbcfc05e9b75ed17a2c3a4c9f0562",
    folder="",
    license="Apache-2.0",
    files={
        "lumbarModel_scaled.osim": "2c202709deaf3c1ef85e0c528dd2933915b5c24e43311d88a40384400fb303d8",
        **_LIFTS,
    },
    origins={
        "lumbarModel_scaled.osim": "OpenSim model/lumbarModel_scaled.osim",
        **{file: f"Sample data/{file}" for file in _LIFTS},
    },
)

KNEE_IMPLANT = DataSet(
    name="knee_implant",
    repository="metinbicer/fmax_iso_sensitivity",
    commit="d927caa3df0b21bda17a1971db80c1d5e478febb",
    folder="",
    license="GPL-3.0",
    files={
        "ExternalLoads.xml": "6d91f08ccd2e4f6935d702d6d25f383f897025fa502dea9f50687474cd69bb0a",
        "ForceSet.xml": "2aae99b4962e6dfa8490721c60cc5e5ce167a4282d82ae39d64c5f26a2a5cf74",
        "GC5_ss1.mot": "80cc67598eb926ed6a84c95b81fc9f2f19c9400f1c14eb5a5fd9f2d77573a06f",
        "GC5_ss1_kinetics.mot": "cf8d2bf4fbda0cfb322f5d54fc8a7347e43132cc7a513ddcb1983970fdb19fc2",
        "GC5_ss3.mot": "3d92cb14ef678eaa10b92f58c038699016d8dfd882774de5cebb957b3ed2f6c8",
        "GC5_ss3_kinetics.mot": "61c2ee1f32e456ddb86cf2647929c6d5d1996d6e5d63ece99757549ba0e50d64",
        "GC5_ss8.mot": "f0328f3ad2627070cdf76948758b4e05dc05ab68bc2fe3cfb75c177cefebe4de",
        "GC5_ss8_kinetics.mot": "d4a9b8527c0bb938883edb814c7b3b734057a1ff72621ed9b9d9b65da8815c4e",
        "Rajagopal2015-scaled.osim": "2f337232a3ad8757de63ceb8ee00e1f4b595ec54edaa30dcf69ee5fef863a88a",
        "eTibia_data.mat": "5e073d90c579566c0ab73b27f0c3d07fb4ecfa7c40b9044b52f49ae91f2a8f3e",
    },
    origins={
        **{file: f"0_xml/{file}" for file in ("ExternalLoads.xml", "ForceSet.xml")},
        **{f"GC5_{trial}{kind}.mot": f"1_data/GC5_{trial}{kind}.mot"
           for trial in ("ss1", "ss3", "ss8") for kind in ("", "_kinetics")},
        "Rajagopal2015-scaled.osim": "2_models/Rajagopal2015-scaled.osim",
    },
)  # fmt: skip


TREADMILL = DataSet(
    name="treadmill",
    repository="CEINMS-RT/LowerLimbModel",
    commit="4056e1c6de2276f174c1b1ef3f1de5ea017a0f07",
    folder="",
    license="Apache-2.0",
    files={
        "gait2392.osim": "b6bfb8bb76997fd6a30e91812511d533ead75f7ff3f8fc47168644585165ec10",
        "run81/XLD.mot": "f245bbe6b04f57f44b3bc0cb1df8efe6d4d11f826dfbcb60c23c425cca5f9ce3",
        "run81/emgFilt.sto": "3f50860cf66753e16a3ac790ef4517bd8ccd6bd7c2228c74d160227b295eccd9",
        "run81/ik.sto": "09ed9ef494dbc78e192346056adbb9702fcd110d78bd73b77219a9b0c78f4d9f",
        "walk36/XLD.mot": "0b2acf1beae77c2d33e685aa042173bcdb56c883932d51ec4eea3806b6745aae",
        "walk36/emgFilt.sto": "ea4e6d254a32a4d1a0373d7e2555dc5c2327d524aa6a3c140e349408668e21ab",
        "walk36/ik.sto": "9062c2ff23da5626fa1b4b9673803dd557262eb4363b1e0c0db63fc7ece0f15f",
    },
    origins={
        "gait2392.osim": "model/gait2392.osim",
        **{f"{trial}/{file}": f"data/{trial}/{file}"
           for trial in ("run81", "walk36") for file in ("XLD.mot", "emgFilt.sto", "ik.sto")},
    },
)  # fmt: skip


def fetch(data: DataSet, *, cache: str | os.PathLike[str] | None = None, base_url: str = BASE_URL) -> Path:
    """Make sure that all files of a data set are there, unchanged.

    Parameters
    ----------
    data : DataSet
    cache : path, optional
        Folder for what is downloaded; the user's cache folder by default.
    base_url : str
        Server that answers like raw.githubusercontent.com.

    Returns
    -------
    Path
        Folder of the data set.

    Raises
    ------
    DataError
        A file that is missing, different, or cannot be downloaded. The message says what to put where.
    """
    local = os.environ.get(LOCAL_COPY)
    if local:
        return _local_copy(data, Path(local) / data.name)
    try:
        import pooch
    except ImportError:
        raise DataError(
            f"the data set {data.name!r} has to be downloaded, which needs the package pooch: install it, or "
            + _by_hand(data)
        ) from None
    folder = Path(cache) if cache is not None else Path(pooch.os_cache("scso_nlp"))
    folder = folder / data.name
    store = pooch.create(
        path=folder,
        base_url="",
        registry={file: f"sha256:{digest}" for file, digest in data.files.items()},
        urls={file: data.url(file, base_url) for file in data.files},
        retry_if_failed=0,
    )
    talkative = pooch.get_logger()
    level = talkative.level
    talkative.setLevel(logging.WARNING)
    try:
        for file in data.files:
            try:
                store.fetch(file, downloader=_download)
            except Exception as error:  # what the network can do is not one family of exceptions
                raise DataError(
                    f"{file} of the data set {data.name!r} could not be fetched from "
                    f"{data.url(file, base_url)} ({_reason(error)}). Without a network, {_by_hand(data)}"
                ) from None
    finally:
        talkative.setLevel(level)
    return folder


def motion_cache() -> Path | None:
    """Find the folder that keeps extracted motions, for the `cache` of :func:`scso_nlp.load_motion`.

    Returns
    -------
    Path or None
        What the environment variable ``SCSO_CACHE`` names; None without it.
    """
    folder = os.environ.get(MOTION_CACHE)
    return Path(folder) if folder else None


def _download(url: str, output_file: str, _: object) -> None:
    """Download one file; pooch's own downloader leaves its connection open when the transfer breaks."""
    import requests

    with (
        requests.get(url, stream=True, timeout=TIMEOUT) as response,
        open(output_file, "wb") as file,
    ):
        response.raise_for_status()
        for chunk in response.iter_content(chunk_size=2**16):
            file.write(chunk)


def _local_copy(data: DataSet, folder: Path) -> Path:
    missing = [file for file in data.files if not (folder / file).is_file()]
    if missing:
        raise DataError(
            f"{LOCAL_COPY} is set, but {folder} lacks {', '.join(missing[:4])}"
            f"{f' and {len(missing) - 4} more' if len(missing) > 4 else ''}; {_by_hand(data)}"
        )
    for file, digest in data.files.items():
        found = sha256(folder / file)
        if found != digest:
            raise DataError(
                f"{folder / file} is not the file the problem was made for (SHA-256 {found[:12]}…, expected "
                f"{digest[:12]}…); take it from {data.url(file)}"
            )
    return folder


def _by_hand(data: DataSet) -> str:
    return (
        f"put these files of github.com/{data.repository} at commit {data.commit[:12]}"
        f"{f', folder {data.folder!r}' if data.folder else ''}, into a folder {data.name!r} and set "
        f"{LOCAL_COPY} to the folder that holds it: {', '.join(data.files)}"
    )


def _reason(error: Exception) -> str:
    text = str(error)
    if "hash" in text and isinstance(error, ValueError):
        return "the file there is not the one expected: its SHA-256 differs"
    response = getattr(error, "response", None)
    if response is not None:
        return f"the server answered {response.status_code}"
    return f"{type(error).__name__}: {text[:200]}"
