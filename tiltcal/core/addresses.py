"""Addresses of machines and ports, as users write them."""

import re

from tiltcal.core.errors import TiltcalError, shown

PORT_NUMBER = re.compile("[0-9]{1,5}")


def address(text: str) -> tuple[str, int]:
    """HOST:PORT in two.

    Raises:
        TiltcalError: it is not of that form.
    """
    host, _, port = text.rpartition(":")
    if not host or not PORT_NUMBER.fullmatch(port) or not 0 < int(port) < 65536:
        raise TiltcalError(
            "address", found=f"'{text}'", need="HOST:PORT, such as 127.0.0.1:5025", do="correct it"
        )
    return host_of(host), int(port)


def host_of(text: str) -> str:
    """The name or the number of a machine.

    Raises:
        TiltcalError: no machine can have that name.
    """
    try:
        text.encode("idna")
    except UnicodeError as error:
        raise TiltcalError(
            "host",
            found=shown(text),
            need="a name or an address, such as 127.0.0.1",
            do="correct it",
        ) from error
    return text
