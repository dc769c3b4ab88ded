"""Connections of another user to ports of a cluster: `python internal/files/unauthorized_client.py SECONDS PORT...`.

Prints, as JSON, what each kind of connection has reached within some seconds.
"""

from __future__ import annotations

import asyncio
import json
import os
import socket
import ssl
import sys
from typing import Any

from distributed import Client
from distributed.comm import connect
from distributed.security import Security

NOBODY = 65534
SECONDS = float(sys.argv[1]) if __name__ == "__main__" else 0.0


async def by_client(port: int, protocol: str, security: Security | None) -> Any:
    """Run a function on the scheduler."""
    address = f"{protocol}://127.0.0.1:{port}"
    async with Client(address, security=security, asynchronous=True, timeout=SECONDS, set_as_default=False) as client:
        return await client.run_on_scheduler(os.getpid)


async def by_message(port: int, protocol: str, security: Security | None) -> Any:
    """Send the first message of a connection and request the identity of the server."""
    arguments = {} if security is None else security.get_connection_args("client")
    comm = await connect(f"{protocol}://127.0.0.1:{port}", timeout=SECONDS, **arguments)
    await comm.write({"op": "identity", "reply": True})
    return (await comm.read())["type"]


async def by_bytes(port: int, message: bytes, context: ssl.SSLContext | None) -> Any:
    """Send bytes, over TLS without a certificate if there is a context."""
    reader, writer = await asyncio.open_connection("127.0.0.1", port, ssl=context, server_hostname=None)
    writer.write(message)
    await writer.drain()
    # A Dask server greets clients with the number of its frames; a TLS alert has 7 bytes.
    return len(await reader.readexactly(8))


async def attack(port: int) -> dict[str, Any]:
    """Return what each kind of connection has reached: without TLS, then with own or no credentials."""
    unverified = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    unverified.check_hostname, unverified.verify_mode = False, ssl.CERT_NONE
    for protocol, security, context in (("tcp", None, None), ("tls", Security.temporary(), unverified)):
        ways = {
            "client": by_client(port, protocol, security),
            "message": by_message(port, protocol, security),
            "bytes": by_bytes(port, b"GET / HTTP/1.0\r\n\r\n", context),
        }
        tried = [asyncio.wait_for(way, 2 * SECONDS) for way in ways.values()]
        found = dict(zip(ways, await asyncio.gather(*tried, return_exceptions=True), strict=True))
        reached = {name: answer for name, answer in found.items() if not isinstance(answer, BaseException)}
        if reached:
            return reached
    return {}


async def main(ports: list[int]) -> dict[int, dict[str, Any]]:
    """Attack all ports at once."""
    return dict(zip(ports, await asyncio.gather(*map(attack, ports)), strict=True))


if __name__ == "__main__":
    socket.getaddrinfo("127.0.0.1", 1)  # loads the resolver before the privileges are dropped
    if os.getuid() == 0:
        os.setgroups([])
        os.setgid(NOBODY)
        os.setuid(NOBODY)
    print(json.dumps(asyncio.run(main([int(port) for port in sys.argv[2:]]))))
