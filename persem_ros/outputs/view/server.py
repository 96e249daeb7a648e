"""HTTP on 127.0.0.1 for one person: who asks must know the token, and is told nothing else."""

from __future__ import annotations

import errno
import hmac
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
import logging
import secrets
import threading
from typing import Any, TYPE_CHECKING

from persem_ros.errors import PersemError
from persem_ros.guard.words import sentence

if TYPE_CHECKING:
    from persem_ros.outputs.view.pages import Pages

log = logging.getLogger(__name__)
ADDRESS = '127.0.0.1'
AT_ONCE = 32                # connections that are served at the same time
PATIENCE = 60.0             # s without a word from the browser
LONGEST_QUERY = 200         # characters
POLICY = ("default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data: blob:; "
          "connect-src 'self' blob:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'")
HEADERS = (('Content-Security-Policy', POLICY), ('X-Content-Type-Options', 'nosniff'),
           ('Referrer-Policy', 'no-referrer'), ('Cross-Origin-Resource-Policy', 'same-origin'),
           ('Cross-Origin-Opener-Policy', 'same-origin'))


class Server(ThreadingHTTPServer):
    """
    Serves Pages under a token.

    Parameters
    ----------
    pages : Pages
    port : int
        0: any that is free.

    Attributes
    ----------
    address : str
        To open in a browser; has the token.

    Raises
    ------
    PersemError
        Where the port is taken or not to be had.

    """

    daemon_threads = True
    request_queue_size = 64

    def __init__(self, pages: Pages, port: int) -> None:
        self.pages = pages
        self.token = secrets.token_urlsafe(24)
        self._free = threading.BoundedSemaphore(AT_ONCE)
        try:
            super().__init__((ADDRESS, port), Handler)
        except OSError as error:
            why = 'is in use' if error.errno == errno.EADDRINUSE else \
                f'cannot be had ({error.strerror})'
            raise PersemError(f'port {port} {why}; give another one with --port, or --port 0 for '
                              'any that is free') from None
        port = self.server_address[1]
        self.hosts = {f'{name}:{port}' for name in (ADDRESS, 'localhost')}
        self.address = f'http://{ADDRESS}:{port}/{self.token}/'

    def process_request(self, request: Any, client_address: Any) -> None:
        """Serve a connection on a thread of its own, once there is one to be had."""
        self._free.acquire()
        super().process_request(request, client_address)

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        """Serve a connection and make room for the next."""
        try:
            super().process_request_thread(request, client_address)
        finally:
            self._free.release()

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Pass over a browser that went away."""
        log.debug('a request failed', exc_info=True)


class Handler(BaseHTTPRequestHandler):
    """Answers one connection's requests."""

    server: Server
    protocol_version = 'HTTP/1.1'
    timeout = PATIENCE
    server_version, sys_version = 'persem', ''

    def do_GET(self) -> None:       # noqa: N802
        """Answer a request for a page, after a look at who asks."""
        hosts = self.headers.get_all('Host') or []
        path, _, query = self.path.partition('?')
        token, _, name = path.removeprefix('/').partition('/')
        if len(hosts) != 1 or hosts[0].lower() not in self.server.hosts:
            return self._refuse(421, 'this is not the host that was asked for')
        if not hmac.compare_digest(token.encode(), self.server.token.encode()):
            return self._refuse(403, 'open the address that persem map view printed: it has a '
                                     'token that is made anew at each start')
        if len(query) > LONGEST_QUERY:
            return self._refuse(414, 'the query is too long')
        try:
            answer = self.server.pages.answer(name, query)
        except (PersemError, ValueError) as error:
            return self._refuse(400, str(error))
        if answer is None:
            return self._refuse(404, 'there is no such page')
        return self._send(200, answer.kind, answer.data, answer.kept)

    do_HEAD = do_GET

    def send_error(self, code: int, message: str | None = None, explain: str | None = None,
                   ) -> None:
        """Refuse what is no request, or another method, in a word."""
        other = code == 501
        self._refuse(405 if other else code, 'only GET is answered' if other else
                     message or 'bad request')

    def log_message(self, format: str, *args: Any) -> None:     # noqa: A002
        """Tell requests to those who debug; without the token."""
        log.debug('%s', (format % args).replace(self.server.token, '...'))

    def _refuse(self, code: int, why: str) -> None:
        """Answer with a sentence, and close: what follows on the line may be anything."""
        self.close_connection = True
        self._send(code, 'text/plain; charset=utf-8', f'{sentence(why)}\n'.encode(
            'utf-8', 'replace'), False)

    def _send(self, code: int, kind: str, data: bytes, kept: bool) -> None:
        """Send an answer with the headers that keep it among ourselves."""
        self.send_response(code)
        for name, value in HEADERS:
            self.send_header(name, value)
        self.send_header('Content-Type', kind)
        self.send_header('Content-Length', str(len(data)))
        self.send_header('Cache-Control', 'private, max-age=86400, immutable' if kept
                         else 'no-store')
        if code == 405:
            self.send_header('Allow', 'GET, HEAD')
        if self.close_connection:
            self.send_header('Connection', 'close')
        self.end_headers()
        if getattr(self, 'command', None) != 'HEAD':
            self.wfile.write(data)
