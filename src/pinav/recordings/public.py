"""Public recordings whose truth is known independently: whence, and how to get them.

A file is taken from its authors' repository at one commit, its checksum is verified,
and its numbers are written as a text table with a header. Nothing is smoothed,
resampled or left out. Where no licence is stated the recording may be used beside
pinav, and is not part of it.
"""

import gzip
import hashlib
import io
import urllib.error
import urllib.request
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import BinaryIO, NamedTuple

import numpy as np
from jaxtyping import Float

from pinav.errors import InputError
from pinav.files import atomic_write

MAX_BYTES = 2**25
"""Size beyond which a download is none of these files."""

SECONDS = 60.0
"""Time after which a server that does not answer is given up."""


Columns = Mapping[str, Float[np.ndarray, " row"]]


class PublicRecording(NamedTuple):
    """A recording in a public repository.

    Attributes:
        path: path of the file in the GitHub repository.
        file: name of the table that is written.
        rate: frames per second [1/s].
    """

    name: str
    summary: str
    repository: str
    commit: str
    path: str
    licence: str
    sha256: str
    file: str
    rate: float
    columns: Callable[[bytes], Columns]
    reference: str

    @property
    def address(self) -> str:
        """Address of the file itself."""
        place = f"{self.repository}/{self.commit}/{self.path}"
        return f"https://raw.githubusercontent.com/{place}"

    @property
    def by_hand(self) -> str:
        """The commands that get it where pinav has no network."""
        folder = self.repository.partition("/")[2]
        return (
            f"git clone https://github.com/{self.repository}; git -C {folder} checkout "
            f"{self.commit}; pinav data fetch {self.name} --source "
            f"{folder}/{self.path}"
        )


def _rows(content: bytes) -> Float[np.ndarray, "row column"]:
    """Numbers of a text, without its last column, a rounded time."""
    return np.loadtxt(io.BytesIO(content), ndmin=2)[:, :-1]


def _ring(content: bytes) -> Columns:
    return {f"angle_{i:02d}_rad": angle for i, angle in enumerate(_rows(content).T)}


def _read_dragged(content: bytes) -> Columns:
    trap, bead = _rows(content).T
    return {"trap_um": trap, "bead_um": bead}


def _rest(content: bytes) -> Columns:
    """Position in m."""
    return {"bead_um": _rows(content)[:, 0] * 1e6}


def _wall(content: bytes) -> Columns:
    """A MATLAB file with x, y and z in um."""
    from scipy.io import loadmat

    arrays = loadmat(io.BytesIO(content), variable_names=["x", "y", "z"])
    return {f"{name}_um": arrays[name].ravel() for name in ("x", "y", "z")}


TWEEZERS = "softmatterlab/OpticalTweezersTutorial"
TWEEZERS_COMMIT = "5954c090060699a02566767d4ffe625b884c72c4"
GIESELER = "Gieseler et al., Adv. Opt. Photon. 13, 74 (2021)"

PUBLIC = (
    PublicRecording(
        name="wall_bead_60hz",
        summary="bead above a wall, x, y, z by holography, 115 000 frames at 60 Hz",
        repository="eXpensia/Confined-Brownian-Motion",
        commit="bd0eb6dea929727ea081dae060a7d1aa32efafd1",
        path="02_body/chapter3/images/trajctory_analysis/data_graphs.mat",
        licence="MIT, Copyright (c) 2021 Maxime Lavaud",
        sha256="fb0f01c45c37c985b65f27ced6b4a42d1ba561a6f9352810d247480a889c0226",
        file="recording.csv.gz",
        rate=60,
        columns=_wall,
        reference="Lavaud et al., Phys. Rev. Research 3, L032011 (2021)",
    ),
    PublicRecording(
        name="ring_driven_bead",
        summary="bead driven round a ring, 39 tracks of 10 000 angles at 150 Hz",
        repository=TWEEZERS,
        commit=TWEEZERS_COMMIT,
        path="sec_4_5_statistical_physics/Fluctuation_dissipation_relation_for_NESS/"
        "data/trajNESS_data.txt",
        licence="none stated",
        sha256="992163422fa6ee6e7898f8751ed1dc8c8bc612f8e417c3b60e34a7a9b2aff018",
        file="angles.csv.gz",
        rate=150,
        columns=_ring,
        reference="Gomez-Solano et al., Phys. Rev. Lett. 103, 040601 (2009); "
        f"{GIESELER}",
    ),
    PublicRecording(
        name="dragged_trap",
        summary="bead in a trap that moves at a constant speed, 8001 frames at 145 Hz",
        repository=TWEEZERS,
        commit=TWEEZERS_COMMIT,
        path="sec_4_5_statistical_physics/first_law_stochastic_thermodynamics/data/"
        "StochThermoTrajectory_data.txt",
        licence="none stated",
        sha256="80da7843a802e78254853c94d5a90b5ff023829123596dd1423f87b0218e1d17",
        file="recording.csv.gz",
        rate=145,
        columns=_read_dragged,
        reference=GIESELER,
    ),
    PublicRecording(
        name="trap_at_rest",
        summary="bead in a trap at rest, 29 999 frames at 145 Hz",
        repository=TWEEZERS,
        commit=TWEEZERS_COMMIT,
        path="sec_4_3_microrheology/data/PassiveMicrorheologyData/Water.txt",
        licence="none stated",
        sha256="bc2cd0b4b246a4a688ac569d3ded9cd25ced3234b69121ccdea6550fad35ece0",
        file="recording.csv.gz",
        rate=145,
        columns=_rest,
        reference=GIESELER,
    ),
)
"""Recordings that `python -m validation.truth` knows."""


def public_recording(name: str) -> PublicRecording:
    """The public recording of that name."""
    for recording in PUBLIC:
        if recording.name == name:
            return recording
    known = ", ".join(one.name for one in PUBLIC)
    raise InputError(f"recording {name!r} is unknown; choose one of: {known}")


def fetch_recording(name: str, folder: Path, source: Path | None = None) -> Path:
    """Write a public recording into a new folder of its name, and return the file.

    Args:
        source: the authors' file, if at hand; downloaded otherwise.

    Raises:
        InputError: there is no such recording, no network, the file is another one, or
            it is there already.
    """
    recording = public_recording(name)
    target = folder / name / recording.file
    if target.exists():
        raise InputError(f"{target}: exists already; choose another --out")
    content = _download(recording) if source is None else _read(source)
    digest = hashlib.sha256(content).hexdigest()
    if digest != recording.sha256:
        raise InputError(
            f"{source or recording.address}: expected the checksum "
            f"{recording.sha256[:16]}..., got {digest[:16]}...; take that of commit "
            f"{recording.commit[:12]}"
        )
    columns = recording.columns(content)
    times = np.arange(len(next(iter(columns.values())))) / recording.rate
    text = io.StringIO()
    np.savetxt(
        text,
        np.stack([times, *columns.values()], axis=1),
        fmt="%.6f",
        delimiter=",",
        header=",".join(("t_s", *columns)),
        comments="",
    )
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{target.parent}: cannot be made: {error}") from error
    packed = gzip.compress(text.getvalue().encode(), mtime=0)

    def write(file: BinaryIO) -> None:
        file.write(packed)

    atomic_write(target, write)
    return target


def _read(source: Path) -> bytes:
    try:
        return source.read_bytes()
    except OSError as error:
        raise InputError(f"{source}: cannot be read: {error.strerror}") from error


def _download(recording: PublicRecording) -> bytes:
    try:
        with urllib.request.urlopen(recording.address, timeout=SECONDS) as answer:
            return answer.read(MAX_BYTES)
    except (urllib.error.URLError, OSError) as error:
        reason = getattr(error, "reason", error)
        raise InputError(
            f"{recording.name}: no download ({reason}); by hand: {recording.by_hand}"
        ) from error
