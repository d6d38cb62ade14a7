"""Whether a script says only how far it goes, by the card of its device."""

from __future__ import annotations

import re
from typing import Any, Mapping

from ..content import maps, text

_COMMENT = re.compile("#[^\n]*")
_BETWEEN = re.compile("[;\n]")


def is_relative(card: Mapping[str, Any], script: str) -> bool:
    """Whether the first statement that takes the device anywhere is a relative one, so that the script needs `based-on`.

    A statement that the card does not name is passed over: the device says what is wrong with it.
    """
    verbs = {text(verb, "name"): verb for verb in maps(card, "verbs")}
    for statement in _BETWEEN.split(_COMMENT.sub("", script)):
        verb = verbs.get((statement.split() or [""])[0], {})
        if verb.get("relative") is True:
            return True
        if verb.get("moves") is True and verb.get("in-place") is not True:
            return False
    return False
