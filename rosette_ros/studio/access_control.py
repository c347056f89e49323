# SPDX-License-Identifier: Apache-2.0
"""Who may use the studio: host name, origin, token and size of every request are checked here. ASGI middleware.

Pages, uploads and the websocket all pass. On loopback, host names of other computers are refused (another site could
point its own name to this address), and so are requests from pages of other sites. With a token, only a browser that
has sent it is admitted; from then on a cookie is enough.
"""

import asyncio
import hmac
import logging
import re
import secrets
from collections.abc import Sequence
from importlib import resources
from urllib.parse import parse_qsl

from jinja2 import Template
from starlette.datastructures import MutableHeaders
from starlette.requests import ClientDisconnect, HTTPConnection, Request
from starlette.responses import HTMLResponse, PlainTextResponse, RedirectResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

MOST_UPLOAD = 200 << 20
"""Size of the largest upload, bytes."""
MOST_BODY = MOST_UPLOAD + (1 << 16)
MOST_FORM = 4096
TOO_LARGE = f'expected at most {MOST_UPLOAD >> 20} MB, found more'
CLIENT_GONE = 499
"""Status for a browser that closes the connection before it is answered; nobody reads it."""
SIGN_IN_PATH = '/sign-in'
COOKIE = 'rosette_access_'
"""The port follows: a browser sends cookies to all ports of a computer."""
WRONG_TOKEN_DELAY = 1.0
"""A wrong token is answered after so long, s."""
LOOPBACK = ('localhost', '127.0.0.1', '::1')
HOST = r'(\[[0-9a-f:.]+\]|[a-z0-9._-]+)(:[0-9]{1,5})?'
"""Name or address and port, in small letters."""
FORMS = {'host': HOST, 'origin': f'(null|[a-z][a-z0-9+.-]*://{HOST})?', 'path': r'[^\x00-\x1f\x7f-\x9f\ufffd]*'}
"""What a browser sends; the server puts U+FFFD for bytes that are no UTF-8."""
POLICY = ("default-src 'self' data: blob: 'unsafe-inline' 'unsafe-eval'; connect-src 'self'; "
          "object-src 'none'; base-uri 'self'; form-action 'self'; frame-ancestors 'none'")
"""The browser loads everything from the studio (NiceGUI compiles its templates in the browser)."""
_HEADERS = {'content-security-policy': POLICY, 'x-content-type-options': 'nosniff', 'referrer-policy': 'same-origin'}


class _BodyTooLarge(Exception):
    """More than MOST_BODY was received."""


class AccessControl:
    """Middleware in front of the studio; a token of None admits everybody, names of None any host name."""

    def __init__(self, app: ASGIApp, token: str | None = None, names: Sequence[str] | None = LOOPBACK) -> None:
        self._app, self._token, self._names = app, token, names
        self._key = secrets.token_urlsafe(32)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope['type'] not in ('http', 'websocket'):
            await self._app(scope, receive, send)
            return
        answer = await self._answer(HTTPConnection(scope), receive)
        if answer is None:
            await self._pass(scope, receive, send)
        elif scope['type'] == 'websocket':
            await send({'type': 'websocket.close', 'code': 1008, 'reason': bytes(answer.body).decode()[:120].strip()})
        else:
            await answer(scope, receive, _with_headers(send))

    async def _answer(self, request: HTTPConnection, receive: Receive) -> Response | None:
        """Return the answer to a request that does not reach the studio, None for one that does."""
        headers, scope, length = request.headers, request.scope, request.headers.get('content-length', '0')
        host, origin = (', '.join(headers.getlist(name)).lower() for name in ('host', 'origin'))
        for (what, form), value in zip(FORMS.items(), (host, origin, scope['path']), strict=True):
            if not re.fullmatch(form, value):
                words = f'{what}: expected one as browsers send it, found {ascii(value)[:80]}'
                logging.getLogger(__name__).warning('rosette studio: refused: %s', words)
                return PlainTextResponse(words, 400)
        if self._names is not None and re.sub(r':[0-9]+$', '', host).strip('[]') not in self._names:
            return PlainTextResponse(f'host: expected one of {", ".join(self._names)}, found {host!r}; open the '
                                     'address '
                                     'that the studio printed', 403)
        if origin and origin.partition('://')[2] != host:
            return PlainTextResponse(f'origin: expected a page of this studio, found {origin!r}', 403)
        if headers.get('sec-fetch-site', 'none') not in ('none', 'same-origin') \
                and headers.get('sec-fetch-dest') != 'document':
            return PlainTextResponse('sec-fetch-site: expected a page of this studio, found a part of another '
                                     'page', 403)
        if not length.isdecimal() or int(length) > MOST_BODY:
            return PlainTextResponse(TOO_LARGE, 413)
        if self._token is None:
            return None
        if scope['type'] == 'http' and scope['path'] == SIGN_IN_PATH:
            return await self._sign_in(Request(scope, receive))
        if _is_same(request.cookies.get(_cookie(request), ''), self._key):
            return None
        if scope['type'] == 'websocket':
            return PlainTextResponse('token: wanted; open the page first', 403)
        token = request.query_params.get('token')
        if token is not None and await self._is_right(token):
            rest = request.url.remove_query_params('token').query
            return self._admission(request, scope['path'] + (f'?{rest}' if rest else ''))
        return _sign_in_page(token is not None)

    async def _sign_in(self, request: Request) -> Response:
        body = b''
        if request.method == 'POST':
            async for part in request.stream():
                body += part
                if len(body) > MOST_FORM:
                    break
        fields = dict(parse_qsl(body[:MOST_FORM].decode('utf-8', 'replace')))
        if await self._is_right(fields.get('token', '')):
            return self._admission(request, '/')
        return _sign_in_page(bool(body))

    async def _is_right(self, token: str) -> bool:
        """Return whether this is the token, at once where it is; wrong ones are answered slowly."""
        right = _is_same(token, self._token or '')
        if not right and token:
            await asyncio.sleep(WRONG_TOKEN_DELAY)
        return right

    def _admission(self, request: HTTPConnection, path: str) -> Response:
        answer = RedirectResponse(f'/{path.lstrip("/")}', 303)  # '//host' would be an address elsewhere
        answer.set_cookie(_cookie(request), self._key, httponly=True, samesite='lax')
        return answer

    async def _pass(self, scope: Scope, receive: Receive, send: Send) -> None:
        size, is_whole, waiting = 0, False, [await receive()]

        async def bounded() -> Message:
            nonlocal size, is_whole
            message = waiting.pop() if waiting else await receive()
            if message['type'] == 'http.request':
                size += len(message.get('body', b''))
                is_whole = not message.get('more_body', False)
            elif message['type'] == 'http.disconnect' and is_whole:
                # An answer that ends early is an error to the middlewares outside; the server discards what is sent.
                await asyncio.Event().wait()
            if size > MOST_BODY:
                raise _BodyTooLarge
            return message

        if waiting[0]['type'] == 'http.disconnect':
            await Response(status_code=CLIENT_GONE)(scope, receive, send)
            return

        try:
            await self._app(scope, bounded, _with_headers(send))
        except _BodyTooLarge:
            await PlainTextResponse(TOO_LARGE, 413)(scope, receive, _with_headers(send))
        except ClientDisconnect:
            await Response(status_code=CLIENT_GONE)(scope, receive, send)


def _with_headers(send: Send) -> Send:
    async def guarded(message: Message) -> None:
        if message['type'] == 'http.response.start':
            message = {**message, 'headers': list(message.get('headers', ()))}
            MutableHeaders(scope=message).update(_HEADERS)
        await send(message)

    return guarded


def _sign_in_page(is_wrong: bool) -> Response:
    page = resources.files('rosette_ros.studio').joinpath('sign_in.j2').read_text('utf-8')
    words = 'This is not the token.' if is_wrong else ''
    text = Template(page, autoescape=True).render(action=SIGN_IN_PATH, words=words)
    return HTMLResponse(text, 401, {'cache-control': 'no-store'})


def _cookie(request: HTTPConnection) -> str:
    """Return the name of the cookie of the studio that a request is sent to, by the port in its address."""
    port = re.search(r':([0-9]+)$', request.headers['host'])
    return COOKIE + (port[1] if port else '')


def _is_same(value: str, wanted: str) -> bool:
    return hmac.compare_digest(value.encode('utf-8', 'replace'), wanted.encode())
