"""A Dask cluster: its client, and which addresses are safe to send code to."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
import ipaddress
from typing import Any

from persem_ros.errors import PersemError

PATIENCE = 10               # seconds for a scheduler to answer
SAFE = 'tls', 'wss'         # protocols whose messages come from whom they claim to


@contextmanager
def connected(address: str) -> Iterator[Any]:
    """
    Give a client of a dask cluster.

    Raises
    ------
    PersemError
        Where there is no dask.distributed, no scheduler, no worker, or anybody could send them
        messages: those are code.

    """
    try:
        from distributed import Client
    except ImportError as error:
        raise PersemError(f'--scheduler needs dask.distributed ({error}); install it with: pip '
                          "install '.[cluster]'") from None
    _check_safe(address)
    try:
        begin: Any = Client
        client = begin(address, timeout=PATIENCE, set_as_default=False)
    except (OSError, ValueError, TimeoutError, TypeError) as error:
        raise PersemError(f'--scheduler {address}: no scheduler answers there '
                          f'({" ".join(str(error).split())[:120]}); start one with: dask '
                          'scheduler, and workers with: dask worker ADDRESS --nthreads 1') \
            from None
    with client:
        if not client.scheduler_info()['workers']:
            raise PersemError(f'--scheduler {address}: it has no workers; start some with: dask '
                              f'worker {address} --nthreads 1')
        yield client


def _check_safe(address: str) -> None:
    """Refuse an address of the network without TLS: whoever reaches it runs what he likes."""
    protocol, _, rest = address.rpartition('://')
    host = (rest.rpartition(':')[0] or rest).strip('[]')
    try:
        here = ipaddress.ip_address(host).is_loopback
    except ValueError:
        here = host == 'localhost'
    if not here and protocol not in SAFE:
        raise PersemError(f"--scheduler {address}: dask's messages are code, and without TLS "
                          f'anybody on the network can send them; give tls://{rest} (see '
                          'docs/scale.md) or an address of this machine, tcp://127.0.0.1:8786')
