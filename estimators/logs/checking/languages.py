"""German and French names of channels, as English words.

German names are compounds: ``Lenkradwinkel`` is split into its stems, steering wheel and angle.
"""

from __future__ import annotations

import unicodedata
from collections.abc import Sequence
from functools import cache

__all__ = ["english", "plain_letters"]

#: Stems of German compounds -> words of `estimators.logs.checking.naming`; longer ones are tried first.
_STEMS = {
    "lenkrad": "steer wheel", "lenk": "steer", "lenkung": "steer", "einschlag": "", "gier": "yaw",
    "nick": "pitch", "wank": "roll", "roll": "roll", "winkel": "angle", "rate": "rate",
    "geschwindigkeit": "velocity", "beschleunigung": "accel", "laengs": "x", "quer": "y",
    "vertikal": "z", "hoch": "z", "fahr": "", "fahrzeug": "", "rad": "wheel", "raeder": "wheel",
    "drehzahl": "rpm", "motor": "motor", "dreh": "angular", "drehmoment": "torque", "moment": "torque",
    "antriebs": "drive", "antrieb": "drive", "brems": "brake", "kraft": "force", "vorne": "front",
    "vorn": "front", "vorder": "front", "vorderachse": "front wheel", "hinten": "rear", "hinter": "rear",
    "hinterachse": "rear wheel", "links": "left", "rechts": "right", "breitengrad": "lat",
    "laengengrad": "lon", "rechtswert": "east", "hochwert": "north", "kurs": "course",
    "kurswinkel": "course", "zeit": "time", "stempel": "", "uhr": "",
}  # fmt: skip
#: Stems that are words of their own in English, or a unit: only within a compound.
_NEVER_ALONE = {"rad", "rate", "motor", "roll", "moment", "hoch", "dreh", "brems", "uhr", "stempel", "fahr"}
_FRENCH = {
    "vitesse": "velocity", "lacet": "yaw", "tangage": "pitch", "roulis": "roll", "longitudinale": "x",
    "laterale": "y", "verticale": "z", "braquage": "steer", "volant": "steer wheel", "roue": "wheel",
    "roues": "wheel", "avant": "front", "arriere": "rear", "gauche": "left", "droite": "right",
    "droit": "right", "couple": "torque", "cap": "yaw", "horodatage": "time", "temps": "time",
    "moteur": "motor", "regime": "rpm", "frein": "brake", "freinage": "brake",
}  # fmt: skip
#: Words that are others in English, or short for them: French beside a word that is nothing else.
_FALSE_FRIENDS = {"cap", "regime", "temps"}
#: Of these, French alone too: `regime` alone is that of a motor, or no speed at all.
_ALONE = {"cap", "temps"}
#: Wheels, in names with a word for a wheel of the same language, or for what each wheel has.
_FRENCH_CORNERS = {"avg": "front left", "avd": "front right", "arg": "rear left", "ard": "rear right"}
_GERMAN_CORNERS = {"vl": "front left", "vr": "front right", "hl": "rear left", "hr": "rear right"}
_FRENCH_WHEELS = {"roue", "roues"}
_GERMAN_WHEELS = {"rad", "raeder", "drehzahl", "drehmoment", "moment"}


def plain_letters(name: str) -> str:
    """``Längsbeschleunigung`` -> ``Laengsbeschleunigung``, ``arrière`` -> ``arriere``."""
    name = unicodedata.normalize("NFC", name)  # an umlaut may be a letter and two dots, as macOS writes them
    for umlaut, letters in (
        ("ä", "ae"),
        ("ö", "oe"),
        ("ü", "ue"),
        ("Ä", "Ae"),
        ("Ö", "Oe"),
        ("Ü", "Ue"),
        ("ß", "ss"),
    ):
        name = name.replace(umlaut, letters)
    apart = unicodedata.normalize("NFKD", name)
    return "".join(letter for letter in apart if not unicodedata.combining(letter))


def english(words: Sequence[str]) -> list[list[str] | None]:
    """English words for each word of a name, in small, plain letters; None for those of no other language."""
    french = any(word in _FRENCH and word not in _FALSE_FRIENDS for word in words)
    left_out = set() if french else _FALSE_FRIENDS - (_ALONE if len(words) == 1 else set())
    found = [None if word in left_out else _english(word) for word in words]
    if all(one is None for one in found):
        return found
    corners = _FRENCH_CORNERS if _FRENCH_WHEELS & set(words) else {}
    if any(_GERMAN_WHEELS & set(_split(word) or ()) for word in words):
        corners = {**corners, **_GERMAN_CORNERS}
    return [
        corners[word].split() if one is None and word in corners else one
        for word, one in zip(words, found, strict=True)
    ]


def _english(word: str) -> list[str] | None:
    if word in _FRENCH:
        return _FRENCH[word].split()
    stems = None if word in _NEVER_ALONE else _split(word)
    return None if stems is None else " ".join(_STEMS[stem] for stem in stems).split()


@cache
def _split(word: str) -> tuple[str, ...] | None:
    """The stems that a compound consists of, the longest first."""
    if not word:
        return ()
    for length in range(len(word), 2, -1):
        rest = _split(word[length:]) if word[:length] in _STEMS else None
        if rest is not None:
            return (word[:length], *rest)
    return None
