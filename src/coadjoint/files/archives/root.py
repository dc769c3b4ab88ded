"""The root of an archive: the attributes of the run, the metadata of all arrays, and the checksum of both.

The checksum does not depend on how the JSON is formatted. It detects damage, not forgery.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from typing import Any

from coadjoint.files.archives.folder import (
    MAX_NAME_LENGTH,
    ArchiveError,
    Folder,
    Location,
    no_archive,
    open_location,
    reading,
)
from coadjoint.files.archives.stored_arrays import StoredArray
from coadjoint.files.records.entries import decode_json
from coadjoint.short_repr import short
from coadjoint.validation import is_integer

FORMAT = 2
"""Version of the format; later versions of the library read earlier ones. Format 1 has checksums of chunks and states
alone, which do not bind them to their place or to the run.
"""
ROOT_FILE = "zarr.json"
HIDDEN_FOLDER = ".coadjoint"
GROUP_METADATA = {"zarr_format": 3, "node_type": "group"}
VERSION_ATTRIBUTE = "archive_format"
FIRST_STEP: str = "archive_first_step"
RUN, ROOT_DIGEST = "archive_run", "archive_sha256"
"""Attributes with the random name of the run, and with the checksum of attributes and array metadata."""
MAX_ARRAYS = 10**5  # of an archive, which has some ten and one for each observed name


def identity_of(attributes: Mapping[str, Any]) -> str:
    """Return what tells a run from others: its random name, or in format 1 the digest of its first step."""
    return str(attributes.get(RUN, attributes.get(FIRST_STEP)))


def root_content(arrays: Mapping[str, StoredArray], attributes: Mapping[str, Any]) -> dict[str, Any]:
    """Return the content of the root."""
    metadata = {name: array.metadata() for name, array in arrays.items()}
    metadata[HIDDEN_FOLDER] = {**GROUP_METADATA, "attributes": {}}
    plain = {name: getattr(value, "item", lambda value=value: value)() for name, value in attributes.items()}
    if plain[VERSION_ATTRIBUTE] == FORMAT:
        plain[ROOT_DIGEST] = _digest(plain, metadata)
    return {
        **GROUP_METADATA,
        "attributes": plain,
        "consolidated_metadata": {"kind": "inline", "must_understand": False, "metadata": metadata},
    }


def _digest(attributes: Mapping[str, Any], metadata: Mapping[str, Any]) -> str:
    """Return the checksum of attributes and array metadata: SHA-256 of their JSON, in the order of the names."""
    content = json.dumps({"attributes": attributes, "metadata": metadata}, sort_keys=True)
    return hashlib.sha256(content.encode()).hexdigest()


def read_root(path: Location, folder: Folder | None = None) -> tuple[dict[str, StoredArray], dict[str, Any]]:
    """Return the arrays and attributes of an archive, as currently committed; `folder` is its folder, if open."""
    if folder is None:
        with open_location(path) as opened:
            return read_root(path, opened)
    try:
        with reading(path, ROOT_FILE):
            content = folder.read("", ROOT_FILE)
            try:
                root = decode_json(content.decode("utf-8"), object_pairs_hook=_reject_duplicates)
                attributes = root["attributes"]
                version = attributes[VERSION_ATTRIBUTE]
                metadata = root["consolidated_metadata"]["metadata"]
            except (ValueError, LookupError, TypeError):
                other = "other results are opened by co.load"
                raise ArchiveError(f"{path}: is no archive of a run, or its {ROOT_FILE} is damaged; {other}") from None
    except FileNotFoundError:
        raise no_archive(path) from None
    if not is_integer(version) or version < 1:
        raise ArchiveError(f"{path}: {VERSION_ATTRIBUTE} is {short(version)}; it must be a whole number from 1 up")
    if version > FORMAT:
        raise ArchiveError(
            f"{path}: is an archive of format {short(version)}, and this version of coadjoint reads formats up to "
            f"{FORMAT}; install a later version"
        )
    with reading(path, f"the metadata in {ROOT_FILE}"):
        is_checked, checksum = version == FORMAT or ROOT_DIGEST in attributes, attributes.pop(ROOT_DIGEST, "")
        if is_checked and checksum != _digest(attributes, metadata):
            raise ValueError("the checksum does not match")
        return _arrays_of(metadata), attributes


def _reject_duplicates(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    table = dict(pairs)
    if len(table) < len(pairs):
        raise ValueError("a name is given twice")
    return table


def _arrays_of(metadata: Mapping[str, Any]) -> dict[str, StoredArray]:
    """Parse the metadata of all arrays; ValueError unless they are what `StoredArray.metadata` returns."""
    if len(metadata) > MAX_ARRAYS:
        raise ValueError(f"{len(metadata)} arrays")
    arrays = {}
    for name, entry in metadata.items():
        if name == HIDDEN_FOLDER and entry["node_type"] == "group":
            continue
        # The name becomes a path: allow only identifiers.
        if not name.isidentifier() or len(name.encode()) > MAX_NAME_LENGTH:
            raise ValueError(f"an array is called {short(name)}, which is no plain name")
        array = StoredArray.of_metadata(entry)
        if array.metadata() != entry:
            raise ValueError(f"the metadata of {short(name)} are not those that the library writes")
        array.check()
        arrays[name] = array
    rows = {array.shape[0] for array in arrays.values() if array.grows}
    if len(rows) > 1:
        raise ValueError(f"arrays over time have the lengths {short(sorted(rows))}")
    return arrays
