"""Text spoiled in the ways that editors, programs and disks spoil it."""

import random
import re

EXTREMES = (
    "0", "-1", "1e308", "-1e308", "1e-320", "1e12", ".inf", ".nan", "9" * 400, "true", "null", "''", "abc", "[]", "{}",
    "[1, [2, [3]]]", "{a: {b: 1}}", "2026-11-23", "0x10", "1_000", "!!python/object:os.system x", "&a [*a]", "\u202e1",
)  # fmt: skip
KEY = re.compile(r"^(\s*(?:- )?\{?)([A-Za-z_][A-Za-z0-9_]*)(:)", re.MULTILINE)
NUMBER = re.compile(r"(?<![\w.])-?\d+(?:\.\d+)?(?:e-?\d+)?(?![\w.])")


def flipped(rng: random.Random, text: bytes, _others: list[bytes]) -> bytes:
    """A few bytes replaced."""
    raw = bytearray(text)
    for _ in range(rng.randint(1, 4)):
        raw[rng.randrange(len(raw))] = rng.randrange(256)
    return bytes(raw)


def truncated(rng: random.Random, text: bytes, _others: list[bytes]) -> bytes:
    """Cut off anywhere."""
    return text[: rng.randrange(len(text))]


def spliced(rng: random.Random, text: bytes, others: list[bytes]) -> bytes:
    """The head of one file and the tail of another."""
    other = rng.choice(others)
    return text[: rng.randrange(len(text))] + other[rng.randrange(len(other)) :]


def stuffed(rng: random.Random, text: bytes, _others: list[bytes]) -> bytes:
    """Bytes that belong nowhere, put in somewhere."""
    at = rng.randrange(len(text))
    extra = rng.choice(
        [b"\x00" * 50, b"\xff\xfe", b"\t", b"[" * 3000, b"{" * 300, b": " * 300, b"\r", b"- " * 500, b'"']
    )
    return text[:at] + extra + text[at:]


def of_lines(rng: random.Random, text: bytes, _others: list[bytes]) -> bytes:
    """Lines lost, doubled, exchanged or moved to another column."""
    lines = text.split(b"\n")
    at, other = rng.randrange(len(lines)), rng.randrange(len(lines))
    match rng.randrange(4):
        case 0:
            del lines[at]
        case 1:
            lines.insert(other, lines[at])
        case 2:
            lines[at], lines[other] = lines[other], lines[at]
        case _:
            lines[at] = b" " * rng.randint(1, 3) + lines[at] if rng.random() < 0.5 else lines[at].lstrip()
    return b"\n".join(lines)


def of_values(rng: random.Random, text: bytes, _others: list[bytes]) -> bytes:
    """A number replaced by what no one expects there."""
    words = text.decode()
    numbers = list(NUMBER.finditer(words))
    if not numbers:
        return text
    number = rng.choice(numbers)
    return (words[: number.start()] + rng.choice(EXTREMES) + words[number.end() :]).encode()


MUTATIONS = (flipped, truncated, spliced, stuffed, of_lines, of_values)


def misspelt(rng: random.Random, text: bytes) -> tuple[bytes, str, str] | None:
    """One key with two letters exchanged, one lost or one doubled: the text, the key and what was made of it."""
    words = text.decode()
    keys = [key for key in KEY.finditer(words) if len(key[2]) > 2]
    if not keys:
        return None
    key = rng.choice(keys)
    name = key[2]
    at = rng.randrange(len(name) - 1)
    wrong = rng.choice(
        [name[:at] + name[at + 1] + name[at] + name[at + 2 :], name[:at] + name[at + 1 :], name[: at + 1] + name[at:]]
    )
    if wrong == name:
        return None
    return (words[: key.start(2)] + wrong + words[key.end(2) :]).encode(), name, wrong
