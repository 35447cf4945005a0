"""Compiled kernels on disk: rebuilt where they are damaged, done without where there is no room.

Every file begins with the hash of the rest; what does not fit it counts as missing.
"""

from __future__ import annotations

import hashlib
import pickle
from pathlib import Path
from typing import Any

import numba.core.caching

from offroad_env.physics._kernel_folder import say_once

__all__ = ["DurableCache"]

_HASH_LENGTH = hashlib.sha256().digest_size


class _CheckedFiles(numba.core.caching.IndexDataCacheFile):  # type: ignore[misc]  # numba has no types
    """Index and data of one kernel; what is damaged counts as missing.

    The data state what they are of: two processes that compile for the first time may give one name to two
    signatures.
    """

    def save(self, key: Any, data: Any) -> None:
        """Store machine code with its key."""
        super().save(key, (key, data))

    def load(self, key: Any) -> Any:
        """The machine code of a key; None where there is none."""
        found = super().load(key)
        return None if found is None or found[0] != key else found[1]

    def _load_index(self) -> dict[Any, str]:
        content = _checked(self._index_path)
        if content is None:
            return {}
        version, stamp, overloads = pickle.loads(content)
        fresh = version == self._version and stamp == self._source_stamp
        return overloads if fresh else {}

    def _save_index(self, overloads: dict[Any, str]) -> None:
        self._save(self._index_path, (self._version, self._source_stamp, overloads))

    def _load_data(self, name: str) -> Any:
        content = _checked(self._data_path(name))
        if content is None:
            raise OSError(f"{name} is damaged")  # which counts as missing
        return pickle.loads(content)

    def _save_data(self, name: str, data: Any) -> None:
        self._save(self._data_path(name), data)

    def _save(self, path: str, content: Any) -> None:
        packed = self._dump(content)
        with self._open_for_write(path) as file:
            file.write(hashlib.sha256(packed).digest() + packed)


def _checked(path: str) -> bytes | None:
    """What a file holds after its hash; None where it is missing or damaged."""
    try:
        with open(path, "rb") as file:
            stated, content = file.read(_HASH_LENGTH), file.read()
    except OSError:
        return None
    return content if hashlib.sha256(content).digest() == stated else None


class DurableCache(numba.core.caching.FunctionCache):  # type: ignore[misc]  # likewise
    """Numba's cache of a function with checked files; a full disk costs the next process time, no more."""

    def __init__(self, py_func: Any) -> None:
        super().__init__(py_func)
        impl = self._impl
        self._cache_file = _CheckedFiles(
            self._cache_path, impl.filename_base, impl.locator.get_source_stamp()
        )

    def save_overload(self, sig: Any, data: Any) -> None:
        """Store a compiled kernel, if there is room."""
        try:
            super().save_overload(sig, data)
        except OSError as error:
            # That of all modules: one sentence, not one for each.
            folder = Path(self._cache_path).parent.parent
            say_once(f"compiled kernels cannot be kept in {folder}: {error.strerror or error}")
