"""Encodings of text files: guessed by their bytes, and read into UTF-8."""

import codecs

from tiltcal.core.errors import TiltcalError

_MARKS = (
    (codecs.BOM_UTF8, "utf-8"),
    (codecs.BOM_UTF16_LE, "utf-16"),
    (codecs.BOM_UTF16_BE, "utf-16"),
)
_HIGH = 0x80
_GB2312 = 0xA1  # both bytes of a character of GB 2312 are at least this


def guess_encoding(head: bytes) -> tuple[str, str]:
    """The encoding of a text, and the reason.

    Args:
        head: the beginning of the file.
    """
    for mark, name in _MARKS:
        if head.startswith(mark):
            return name, "a byte order mark says so"
    pairs = head[: len(head) // 2 * 2]
    if pairs and pairs[1::2].count(0) > len(pairs) / 8:
        return "utf-16-le", "every second byte is zero"
    if pairs and pairs[::2].count(0) > len(pairs) / 8:
        return "utf-16-be", "every first byte of two is zero"
    if head.isascii():
        return "utf-8", "all characters are ASCII"
    try:
        codecs.getincrementaldecoder("utf-8")().decode(head)
    except UnicodeDecodeError:
        if _in_pairs(head):
            return "gb18030", "no UTF-8; high bytes stand in pairs as in GBK"
        return "cp1252", "no UTF-8; single high bytes as in Western European text"
    return "utf-8", "all bytes are valid UTF-8"


def _in_pairs(head: bytes) -> bool:
    """Whether all bytes above ASCII stand in pairs of GB 2312."""
    k, end = 0, len(head) - 1
    while k < end:
        if head[k] >= _HIGH:
            if head[k] < _GB2312 or head[k + 1] < _GB2312:
                return False
            k += 1
        k += 1
    return True


def to_utf8(data: bytes, encoding: str, source: str) -> bytes:
    """The text in UTF-8 without a byte order mark, line ends as ``\\n``.

    Raises:
        TiltcalError: the encoding has no such name, or the text is not written in it.
    """
    for mark, name in _MARKS:
        if data.startswith(mark):
            encoding = name
    try:
        codec = codecs.lookup(encoding)
        if codec.name == "utf-8":
            data = data.removeprefix(codecs.BOM_UTF8)
            if not data.isascii():
                data = data.decode("utf-8", errors="replace").encode()
        else:
            data = data.decode(encoding).encode("utf-8", errors="replace")
    except (LookupError, UnicodeError) as error:
        raise TiltcalError(
            f"foreign recording {source}",
            found=str(error),
            need=f"text in {encoding}",
            do="set file.encoding in the mapping: utf-8, utf-16, gb18030, cp1252",
        ) from error
    return data.replace(b"\r\n", b"\n").replace(b"\r", b"\n") if b"\r" in data else data
