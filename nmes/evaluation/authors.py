"""Which names of authors are the same: a name is what is seen of it.

Letters of other scripts that look the same, and what is not seen at all, make no other name. Which letters do is after
Unicode Technical Standard 39, for those that look like Latin ones.
"""

from __future__ import annotations

import re
import unicodedata
from typing import Final

__all__ = ["author_forms"]

_UNSEEN: Final = re.compile(
    r"[\u00ad\u034f\u061c\u115f\u1160\u17b4\u17b5\u180b-\u180f\u200b-\u200f\u202a-\u202e\u2060-\u206f\u2800"
    r"\u3164\ufe00-\ufe0f\ufeff\uffa0\ufff0-\ufff8"
    r"\U00016fe4\U0001bca0-\U0001bca3\U0001d159\U0001d173-\U0001d17a\U000e0000-\U000e0fff]"
)
# Letters of Cyrillic, Greek, Armenian, Cherokee, Lisu, Coptic, Tifinagh, Deseret and Osage, runes, Canadian syllabics,
# Latin letters and digits, by the small Latin letter that they look like: large and small ones make no difference.
_LIKE: Final = {
    "a": "\u0410\u0391\u13aa\ua4ee\u2c80\u15c5\u0430\u03b1\u0251",
    "b": "\u0412\u0392\u13f4\ua4d0\u2c82\u15f7\u13cf",
    "c": "\u0421\u13df\ua4da\u2ca4\U00010415\u03f9\u0441\u03f2\u03c2",
    "d": "\u0501\u13e7\ua4d2\u146f\u0500\u13a0\ua4d3\u15de\u15ea",
    "e": "\u0415\u0395\u13ac\ua4f0\u2d39\u0435",
    "f": "\ua4dd\u15b4",
    "g": "\u0581\u0261\u13c0\u13f3\ua4d6\u050c",
    "h": "\u041d\u0397\u13bb\ua4e7\u2c8e\u157c\u04bb\u0570\u13c2",
    "i": "\u0456\u03b9\u0131\u13a5\u0269",
    "j": "\u0408\u13ab\ua4d9\u148d\u037f\u0458\u03f3\u0237",
    "k": "\u041a\u039a\u13e6\ua4d7\u2c94\u16d5\u03ba\u0138",
    "l": (
        "\u0406\u04cf\u04c0\u0399I1|\ua4f2\u2c92\u16c1\u01c0\u0196\u2223\u05c0\u07ca\u2d4f\u13de\ua4e1\U0001041b\u14aa"
    ),
    "m": "\u041c\u039c\u13b7\ua4df\u2c98\u15f0\u16d6",
    "n": "\u039d\ua4e0\u2c9a\u0578\u03b7",
    "o": (
        "\u041e\u039f\u05550\ua4f3\u2c9e\U00010404\U000104c2\u2d54\u043e\u03bf\u0585\u0966\u09e6\u0a66"
        "\u0ae6\u0b66\u0c66\u0ce6\u0d66\u0e50\u0ed0\u1040"
    ),
    "p": "\u0420\u03a1\u13e2\ua4d1\u2ca2\u146d\u0440\u03c1",
    "q": "\u051a\u2d55\u051b\u0563\u0566",
    "r": "\u13a1\u13d2\ua4e3\u1587\u0433",
    "s": "\u0405\u054f\u13d5\u13da\ua4e2\U00010420\u1515\u0455",
    "t": "\u0422\u03a4\u13a2\ua4d4\u2ca6",
    "u": "\u03c5\u057d\u054d\ua4f4\u144c",
    "v": "\u0474\u13d9\ua4e6\u142f\u0475\u03bd",
    "w": "\u051c\u13b3\u13d4\ua4ea\u051d\u0561",
    "x": "\u0425\u03a7\ua4eb\u2cac\u166d\u16b7\u0445\u03c7\u2d5d",
    "y": "\u0423\u04ae\u03a5\u13a9\u13bd\ua4ec\u2ca8\u0443\u04af\u03b3",
    "z": "\u0396\u13c3\ua4dc",
}
_BICAMERAL: Final = ("CHEROKEE", "COPTIC", "DESERET", "OSAGE")  # whose small letters are the large ones, but smaller
_SMALL_CAPITALS: Final = {
    ord(unicodedata.lookup(f"LATIN LETTER SMALL CAPITAL {letter}")): "l" if letter == "I" else letter.lower()
    for letter in "ABCDEFGHIJKLMNOPQRSTUVWYZ"
}
_LOOKS: Final = _SMALL_CAPITALS | {
    ord(form): letter
    for letter, others in _LIKE.items()
    for other in others
    for form in ((other, other.lower()) if unicodedata.name(other).startswith(_BICAMERAL) else other)
}


def author_forms(author: str) -> tuple[str, ...]:
    """Returns the forms of an author's name: two names that share one look alike; none for an empty name."""
    seen, looks = (_UNSEEN.sub("", unicodedata.normalize("NFKC", text)) for text in (author, author.translate(_LOOKS)))
    forms = (" ".join(text.casefold().split()) for text in (seen, looks.translate(_LOOKS)))
    return tuple(form for form in forms if form)
