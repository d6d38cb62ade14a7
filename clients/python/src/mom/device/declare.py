"""What a device declares of itself: its verbs with their arguments, and the fields of its state."""

from __future__ import annotations

import inspect
import math
import re
from dataclasses import dataclass
from typing import (
    Any,
    Callable,
    Dict,
    List,
    Literal,
    Mapping,
    Optional,
    Tuple,
    TypeVar,
    get_args,
    get_origin,
    get_type_hints,
    overload,
)  # fmt: skip

from .errors import syntax
from .script import WAIT
from .words import ScriptWord, Words, read_number, read_whole

_VERB = "__mom_verb__"
NAME = re.compile(r"[A-Za-z0-9_.@+=-]{1,64}")
"""What the words of a card may be."""
_LONGEST_VELOCITY = 60_000

F = TypeVar("F", bound=Callable[..., Any])


class Kind:
    """What an argument or a field of the state is: a `Number`, a `Whole`, a `Word`, an `Attachment` or a `Flag`."""

    type = ""
    """The word of the card."""
    does = ""
    """What a field of the state says, for people."""

    def card(self) -> Dict[str, Any]:
        """Its part of the card."""
        return {"type": self.type}

    @property
    def unit_of(self) -> str:
        """Its unit behind its name, such as `/mm`."""
        return ""

    def takes(self, value: Any) -> bool:
        """Whether a word of a script could be this value."""
        return False

    def read(self, word: ScriptWord, verb: str, takes: str, which: str) -> Any:
        """The value that a word of a script is; raises `syntax` at that word."""
        raise NotImplementedError


@dataclass(frozen=True)
class Number(Kind):
    """A finite number in a unit, between two bounds: `Annotated[float, Number("mm", -1000, 1000)]`."""

    unit: str = ""
    min: Optional[float] = None
    max: Optional[float] = None
    does: str = ""

    type = "number"
    _what = "a number"

    def __post_init__(self) -> None:
        if self.min is not None and self.max is not None and self.min > self.max:
            raise TypeError(f"{self.min:g} as the least is more than {self.max:g} as the most")

    def card(self) -> Dict[str, Any]:
        """Its part of the card."""
        bounds = {key: value for key, value in (("min", self.min), ("max", self.max)) if value is not None}
        return {"type": self.type, **({"unit": self.unit} if self.unit else {}), **bounds}

    @property
    def unit_of(self) -> str:
        """Its unit behind its name."""
        return f"/{self.unit}" if self.unit else ""

    def read(self, word: ScriptWord, verb: str, takes: str, which: str) -> Any:
        """The number; `syntax` for what is not one, or lies outside of its bounds."""
        value = self._value(word.text)
        if value is None or not self._is_within(value):
            text = f"`{verb}` takes {takes}: {which} is {self._what}{self._range()}, not `{word.short}`"
            raise syntax(word.at, text)
        return value

    def takes(self, value: Any) -> bool:
        """Whether it is such a number, within its bounds."""
        is_number = isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)
        return is_number and self._is_within(value)

    def _is_within(self, value: float) -> bool:
        return (self.min is None or value >= self.min) and (self.max is None or value <= self.max)

    def _value(self, text: str) -> Optional[float]:
        return read_number(text)

    def _range(self) -> str:
        unit = f" {self.unit}" if self.unit else ""
        if self.min is not None and self.max is not None:
            return f" from {self.min:g} to {self.max:g}{unit}"
        if self.min is not None:
            return f" of at least {self.min:g}{unit}"
        return f" of at most {self.max:g}{unit}" if self.max is not None else ""


@dataclass(frozen=True)
class Whole(Number):
    """A whole number in a unit, between two bounds: `Annotated[int, Whole("ms", 0, 1000)]`."""

    type = "whole"
    _what = "a whole number"

    def takes(self, value: Any) -> bool:
        """Whether it is such a number, within its bounds."""
        return isinstance(value, int) and super().takes(value)

    def _value(self, text: str) -> Optional[float]:
        return read_whole(text)


class Word(Kind):
    """A word, one of these where there are any: `Annotated[str, Word("open", "close")]`."""

    type = "word"

    def __init__(self, *choices: str, does: str = "") -> None:
        self.choices, self.does = choices, does
        if not all(NAME.fullmatch(choice) for choice in choices):
            raise TypeError(f"the choices of a word are letters, digits and some marks, not {choices!r}")

    def takes(self, value: Any) -> bool:
        """Whether it is one of these words."""
        return isinstance(value, str) and (value in self.choices if self.choices else bool(NAME.fullmatch(value)))

    def card(self) -> Dict[str, Any]:
        """Its part of the card."""
        return {"type": self.type, **({"choices": list(self.choices)} if self.choices else {})}

    def read(self, word: ScriptWord, verb: str, takes: str, which: str) -> str:
        """The word; `syntax` with the nearest of its choices where it is another."""
        if self.choices and word.text not in self.choices:
            nearest = word.nearest(self.choices)
            known = " or ".join(f"`{one}`" for one in self.choices)
            text = f"`{verb}` takes {takes}: {which} is {known}, not `{word.short}`; did you mean `{nearest}`?"
            raise syntax(word.at, text).with_nearest(nearest)
        return word.text


class Attachment(Kind):
    """Bytes that come with the script, by their name: `Annotated[bytes, Attachment()]`, or just `bytes`."""

    type = "attachment"

    def read(self, word: ScriptWord, verb: str, takes: str, which: str) -> str:
        """The name; the bytes are fetched when the whole script was read."""
        return word.text


class Flag(Kind):
    """A field of the state that is `True` or `False`."""

    type = "boolean"

    def __init__(self, does: str = "") -> None:
        self.does = does


@dataclass(frozen=True)
class Argument:
    """An argument of a verb."""

    name: str
    """In scripts and in the card."""
    parameter: str
    """In Python."""
    kind: Kind
    default: Any = inspect.Parameter.empty
    """What holds where it is left out; only the last arguments have one."""

    @property
    def is_optional(self) -> bool:
        """Whether it may be left out."""
        return self.default is not inspect.Parameter.empty

    @property
    def usage(self) -> str:
        """How it stands in a statement: `x/mm`, `[ms/ms]`."""
        usage = f"{self.name}{self.kind.unit_of}"
        return f"[{usage}]" if self.is_optional else usage

    def card(self) -> Dict[str, Any]:
        """Its part of the card."""
        default = {"default": self.default} if self.is_optional else {}
        return {"name": self.name, **self.kind.card(), **default}


@dataclass(frozen=True)
class Verb:
    """A verb of a device."""

    name: str
    does: str
    method: str
    """The name of the method."""
    arguments: Tuple[Argument, ...]
    moves: bool
    relative: bool
    velocity: Optional[int]
    """ms for which it goes on."""

    def read(self, words: Words) -> Dict[str, Any]:
        """The arguments of a statement, by the names of the method's parameters; raises `syntax`."""
        takes = " ".join(argument.usage for argument in self.arguments)
        values: Dict[str, Any] = {}
        for argument in self.arguments:
            if argument.is_optional and words.is_over:
                values[argument.parameter] = argument.default
            else:
                word = words.need(self.name, takes, argument.name)
                values[argument.parameter] = argument.kind.read(word, self.name, takes, argument.name)
        return values

    def card(self) -> Dict[str, Any]:
        """Its part of the card."""
        card: Dict[str, Any] = {"name": self.name, **({"does": self.does} if self.does else {})}
        if self.arguments:
            card["args"] = [argument.card() for argument in self.arguments]
        card["moves"] = self.moves
        card.update({"relative": True} if self.relative else {})
        card.update({"velocity": True} if self.velocity is not None else {})
        return card


@dataclass(frozen=True)
class _Options:
    """What `verb` was told."""

    name: Optional[str]
    moves: bool
    relative: bool
    velocity: Optional[int]


@overload
def verb(function: F) -> F: ...
@overload
def verb(
    *, name: Optional[str] = None, moves: bool = True, relative: bool = False, velocity: Optional[int] = None
) -> Callable[[F], F]: ...
def verb(
    function: Optional[F] = None,
    *,
    name: Optional[str] = None,
    moves: bool = True,
    relative: bool = False,
    velocity: Optional[int] = None,
) -> Any:
    """Makes a method a verb of the device's scripts: `go 10 20` calls `go(10.0, 20.0)`.

    A coroutine function has come to its end when it returns; it is cancelled before the device is halted. A plain function ends at once,
    and must not block. Its parameters say what follows in a statement: their type, and in `Annotated` a `Number`, `Whole`, `Word` or
    `Attachment`; the last ones may have defaults. The first paragraph of its comment says what it does.

    - `name`: in scripts, if it is not that of the method with `-` for `_`.
    - `moves`: `False` for what takes the device nowhere, such as a lamp.
    - `relative`: it says only how far it goes; its command has to name the state that it is based on.
    - `velocity`: ms for which it goes on, until the next command at most. It gives way to that and waits behind no other. When it ends the
      device is halted, unless another velocity follows.
    """
    options = _Options(name, moves, relative, velocity)

    def declare(function: F) -> F:
        setattr(function, _VERB, options)
        return function

    return declare if function is None else declare(function)


def verbs_of(owner: type) -> List[Verb]:
    """The verbs of a class; raises `TypeError` for what cannot be declared so."""
    found: Dict[str, Verb] = {}
    for method in {name: None for base in reversed(owner.__mro__) for name in vars(base)}:
        function = getattr(owner, method)
        # One that is overridden stays a verb.
        said = [getattr(vars(base).get(method), _VERB, None) for base in owner.__mro__]
        options = next((one for one in said if isinstance(one, _Options)), None)
        if options is None or not callable(function):
            continue
        one = _verb(owner, method, function, options)
        if one.name in found:
            raise TypeError(f"{owner.__name__} has two verbs `{one.name}`")
        found[one.name] = one
    return list(found.values())


def _verb(owner: type, method: str, function: Callable[..., Any], options: _Options) -> Verb:
    where = f"{owner.__name__}.{method}"
    name = options.name or _script_name(method)
    if name == WAIT or not NAME.fullmatch(name):
        raise TypeError(f"{where}: no verb can be called `{name}`")
    if inspect.isgeneratorfunction(function) or inspect.isasyncgenfunction(function):
        raise TypeError(f"{where}: a generator is not a verb, since calling it does nothing: make it a coroutine function that awaits")
    if options.velocity is not None and not 0 < options.velocity <= _LONGEST_VELOCITY:
        raise TypeError(f"{where}: a velocity goes on for 1 to {_LONGEST_VELOCITY} ms, not {options.velocity}")
    if options.velocity is not None and (options.relative or not options.moves):
        raise TypeError(f"{where}: a velocity moves the device, and is not relative")
    if options.relative and not options.moves:
        raise TypeError(f"{where}: what takes the device nowhere is not relative")
    arguments = tuple(_arguments(where, function))
    does = does_of(function)
    return Verb(name, does, method, arguments, options.moves, options.relative, options.velocity)


def _arguments(where: str, function: Callable[..., Any]) -> List[Argument]:
    try:
        hints = get_type_hints(function, include_extras=True)
    except (NameError, TypeError) as error:
        raise TypeError(f"{where}: its types have to be known in its module and to this Python: {error}") from error
    found: List[Argument] = []
    for parameter in list(inspect.signature(function).parameters.values())[1:]:
        if parameter.kind is not inspect.Parameter.POSITIONAL_OR_KEYWORD:
            raise TypeError(f"{where}: `{parameter.name}` cannot be said in a script: a verb has plain parameters only")
        kind = _kind(hints.get(parameter.name))
        if kind is None:
            text = "float, int, str, bytes, a Literal of words, or Annotated with Number, Whole, Word or Attachment"
            raise TypeError(f"{where}: the type of `{parameter.name}` has to be {text}")
        argument = Argument(_script_name(parameter.name), parameter.name, kind, parameter.default)
        if not NAME.fullmatch(argument.name):
            raise TypeError(f"{where}: no argument can be called `{argument.name}`")
        if argument.is_optional and not kind.takes(argument.default):
            raise TypeError(f"{where}: {argument.default!r} as the default of `{argument.name}` is nothing that a script could say")
        found.append(argument)
    return found


def _kind(hint: Any) -> Optional[Kind]:
    """What a type hint says."""
    plain: Mapping[Any, Kind] = {float: Number(), int: Whole(), str: Word(), bytes: Attachment()}
    if get_origin(hint) is Literal:
        words = get_args(hint)
        return Word(*words) if all(isinstance(word, str) for word in words) else None
    for said in getattr(hint, "__metadata__", ()):
        if isinstance(said, Kind) and not isinstance(said, Flag):
            return said
    inner = getattr(hint, "__origin__", hint)
    return plain.get(inner) if inner is hint else _kind(inner)


def _script_name(name: str) -> str:
    return name.strip("_").replace("_", "-")


def does_of(described: Any) -> str:
    """The first paragraph of a comment, in one line and without its full stop."""
    first = inspect.cleandoc(getattr(described, "__doc__", None) or "").split("\n\n")[0]
    return " ".join(first.split()).rstrip(".")
