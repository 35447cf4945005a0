"""Weights of models of stable-baselines3, read without running anything that stands in their files.

The zip that stable-baselines3 writes holds a pickle of the whole model besides the weights. The weights alone
are read (`torch.load` with ``weights_only``); the model is made anew from its settings.
"""

from __future__ import annotations

import io
import zipfile
from pathlib import Path
from typing import Any

from offroad_env.errors import DataError
from offroad_env.world.files import MOST_ARRAYS, read_file

__all__ = ["load_parameters"]

#: The file of tensors that belong to no module, such as the entropy coefficient of SAC.
_VARIABLES = "pytorch_variables"


def load_parameters(model: Any, content: bytes | Path, file: str) -> None:
    """Set the weights of a model to those of a zip file of stable-baselines3, given by its bytes or path.

    Raises
    ------
    DataError
        For what is no such file, or holds weights of another model.
    """
    import torch
    from stable_baselines3.common.save_util import recursive_getattr

    packed = read_file(content, most=MOST_ARRAYS) if isinstance(content, Path) else content
    try:
        parts = {
            name: torch.load(io.BytesIO(part), "cpu", weights_only=True)
            for name, part in _parts(packed, file)
        }
        variables = parts.pop(_VARIABLES, None) or {}
        model.set_parameters(parts, exact_match=True, device="cpu")
        for name, value in variables.items():
            recursive_getattr(model, name).data = value.data
    except DataError:
        raise
    except Exception as error:  # what is damaged fails anywhere inside torch, in many ways
        reason = " ".join(str(error).split())[:160] or type(error).__name__
        raise DataError(f"{file}: holds no weights of this model, or is damaged: {reason}") from None


def _parts(packed: bytes, file: str) -> list[tuple[str, bytes]]:
    """(Name, content) of the files with tensors."""
    found = []
    with zipfile.ZipFile(io.BytesIO(packed)) as archive:
        entries = [entry for entry in archive.infolist() if entry.filename.endswith(".pth")]
        if sum(entry.file_size for entry in entries) > MOST_ARRAYS:
            raise DataError(f"{file}: its weights would take more than {MOST_ARRAYS / 1e6:g} MB")
        for entry in entries:
            with archive.open(entry) as part:
                found.append((entry.filename.removesuffix(".pth"), part.read(entry.file_size + 1)))
    return found
