# SPDX-License-Identifier: Apache-2.0
"""The door of the studio: who may come in, from which page, with how much in hand. Plain ASGI.

Everything passes it: pages, uploads and the websocket. On loopback it refuses names that are not this
computer's (a foreign page could otherwise point its own name here) and requests that a foreign page
makes. With a token it lets in only who has shown it once; after that a cookie is enough.
"""

import asyncio
import hmac
import secrets
from importlib import resources
from urllib.parse import parse_qsl, urlencode, urlsplit

from jinja2 import Template

MOST_UPLOAD = 200 << 20
"""Bytes of the largest file that is taken."""
MOST_BODY = MOST_UPLOAD + (1 << 16)
MOST_FORM = 4096
DOOR_PATH = '/door'
COOKIE = 'rosette_door'
WAIT_AFTER_WRONG = 1.0
LOOPBACK = ('localhost', '127.0.0.1', '::1')
POLICY = ("default-src 'self' data: blob: 'unsafe-inline' 'unsafe-eval'; connect-src 'self' ws: wss:; "
          "object-src 'none'; base-uri 'self'; form-action 'self'; frame-ancestors 'none'")
"""What the browser is held to: everything comes from here (the toolkit compiles its templates)."""
_HEADERS = ((b'content-security-policy', POLICY.encode()), (b'x-content-type-options', b'nosniff'),
            (b'referrer-policy', b'same-origin'))


class _TooMuch(Exception):
    """More came in than is taken."""


class Door:
    """ASGI middleware in front of the studio.

    token: None lets everybody in who reaches it; names: host names that requests may be made to,
    None for any.
    """

    def __init__(self, app, token=None, names=LOOPBACK):
        """Stand before `app`."""
        self._app, self._token, self._names = app, token, names
        self._key = secrets.token_urlsafe(32)
        self._one_at_a_time = asyncio.Lock()

    async def __call__(self, scope, receive, send):
        """Let a request pass, or answer it."""
        if scope['type'] not in ('http', 'websocket'):
            await self._app(scope, receive, send)
            return
        headers = {name.decode('latin-1').lower(): value.decode('latin-1') for name, value in scope['headers']}
        refusal = self._refusal(headers)
        if refusal:
            await _refuse(scope, send, *refusal)
        elif scope['type'] == 'http' and self._token and scope['path'] == DOOR_PATH:
            await self._answer_form(scope, receive, send)
        elif self._token and not self._is_known(headers):
            await self._ask(scope, send)
        else:
            await self._pass(scope, receive, send)

    def _refusal(self, headers):
        """Return (status, words) where a request is not taken at all, else None."""
        host = headers.get('host', '')
        if self._names is not None and _name(host) not in self._names:
            return 403, (f'host: wanted one of {", ".join(self._names)}, got {host!r}; open the address '
                         'that the studio printed')
        origin = headers.get('origin')
        if origin is not None and urlsplit(origin).netloc.lower() != host.lower():
            return 403, f'origin: wanted a page of this studio, got {origin!r}'
        length = headers.get('content-length', '0')
        if not length.isdigit() or int(length) > MOST_BODY:
            return 413, f'wanted at most {MOST_UPLOAD >> 20} MB, got more'
        return None

    def _is_known(self, headers):
        shown = [value for part in headers.get('cookie', '').split(';')
                 for name, _, value in [part.strip().partition('=')] if name == COOKIE]
        return any(_same(value, self._key) for value in shown)

    async def _ask(self, scope, send):
        """Take the token from the address, or show the page that asks for it."""
        query = parse_qsl(scope.get('query_string', b'').decode('latin-1'), keep_blank_values=True)
        shown = [value for name, value in query if name == 'token']
        if scope['type'] == 'websocket' or not shown:
            await self._show_page(scope, send, '')
        elif await self._is_right(shown[-1]):
            rest = urlencode([pair for pair in query if pair[0] != 'token'])
            await self._let_in(send, scope['path'] + (f'?{rest}' if rest else ''))
        else:
            await self._show_page(scope, send, 'That is not the token.')

    async def _answer_form(self, scope, receive, send):
        """Take the token from the form."""
        body = b''
        while scope['method'] == 'POST' and len(body) <= MOST_FORM:
            message = await receive()
            body += message.get('body', b'')
            if not message.get('more_body'):
                break
        fields = dict(parse_qsl(body[:MOST_FORM].decode('utf-8', 'replace')))
        if await self._is_right(fields.get('token', '')):
            await self._let_in(send, '/')
        else:
            await self._show_page(scope, send, 'That is not the token.' if body else '')

    async def _is_right(self, shown):
        """Return whether it is the token; a wrong one takes its time, and one after the other."""
        async with self._one_at_a_time:
            right = _same(shown, self._token)
            if not right and shown:
                await asyncio.sleep(WAIT_AFTER_WRONG)
        return right

    async def _let_in(self, send, path):
        path = f'/{path.lstrip("/")}'  # '//host' would be an address elsewhere
        cookie = f'{COOKIE}={self._key}; Path=/; HttpOnly; SameSite=Lax'
        await _answer(send, 303, b'', [(b'location', path.encode('latin-1')),
                                       (b'set-cookie', cookie.encode())])

    async def _show_page(self, scope, send, words):
        if scope['type'] == 'websocket':
            await _refuse(scope, send, 403, 'token: wanted; open the page first')
            return
        page = resources.files('rosette_ros.web').joinpath('door.j2').read_text('utf-8')
        text = Template(page, autoescape=True).render(action=DOOR_PATH, words=words)
        await _answer(send, 401, text.encode(), [(b'content-type', b'text/html; charset=utf-8'),
                                                 (b'cache-control', b'no-store')])

    async def _pass(self, scope, receive, send):
        taken = 0

        async def bounded():
            nonlocal taken
            message = await receive()
            taken += len(message.get('body', b'')) if message['type'] == 'http.request' else 0
            if taken > MOST_BODY:
                raise _TooMuch
            return message

        async def guarded(message):
            if message['type'] == 'http.response.start':
                message = {**message, 'headers': [*message.get('headers', ()), *_HEADERS]}
            await send(message)

        try:
            await self._app(scope, bounded, guarded)
        except _TooMuch:
            await _refuse(scope, send, 413, f'wanted at most {MOST_UPLOAD >> 20} MB, got more')


def _name(host):
    """Return the name in a Host header, without the port."""
    return (urlsplit(f'//{host}').hostname or '').lower()


def _same(shown, wanted):
    return hmac.compare_digest(shown.encode('utf-8', 'replace'), wanted.encode())


async def _refuse(scope, send, status, words):
    if scope['type'] == 'websocket':
        await send({'type': 'websocket.close', 'code': 1008, 'reason': words[:120]})
        return
    await _answer(send, status, f'{words}\n'.encode(), [(b'content-type', b'text/plain; charset=utf-8')])


async def _answer(send, status, body, headers):
    await send({'type': 'http.response.start', 'status': status,
                'headers': [(b'content-length', str(len(body)).encode()), *headers, *_HEADERS]})
    await send({'type': 'http.response.body', 'body': body})
