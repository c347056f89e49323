# SPDX-License-Identifier: Apache-2.0
"""Access control: names, origins, token, size; by itself, on the command line, and in front of the page."""

import asyncio
import os
from concurrent.futures import ThreadPoolExecutor

import pytest
from playwright.sync_api import expect
from starlette.middleware.base import BaseHTTPMiddleware
from starlette.middleware.gzip import GZipMiddleware
from starlette.requests import Request
from starlette.responses import StreamingResponse

from rosette_ros.cli.main import main
from rosette_ros.studio import access_control
from rosette_ros.studio.access_control import COOKIE, MOST_BODY, SIGN_IN_PATH, AccessControl

TOKEN = 'a-token-of-the-tests'
HOST = ('host', '127.0.0.1:8000')


async def studio_app(scope, receive, send):
    """Read the body, answer 200, as the studio does."""
    if scope['type'] == 'websocket':
        await send({'type': 'websocket.accept'})
        return
    while (await receive()).get('more_body'):
        pass
    await send({'type': 'http.response.start', 'status': 200, 'headers': []})
    await send({'type': 'http.response.body', 'body': b'in'})


def ask(made, *headers, path='/', query=b'', method='GET', body=(b'',), kind='http'):
    """Return (status, headers) of a request; of a websocket (type of the answer, {})."""
    sent, parts = [], list(body)

    async def receive():
        part = parts.pop(0)
        return {'type': 'http.request', 'body': part, 'more_body': bool(parts)}

    async def send(message):
        sent.append(message)

    scope = {'type': kind, 'path': path, 'query_string': query, 'method': method,
             'headers': [(name.encode(), value.encode()) for name, value in headers]}
    with ThreadPoolExecutor(1) as thread:  # Playwright has a running loop in the thread of the tests
        thread.submit(asyncio.run, made(scope, receive, send)).result()
    if kind == 'websocket':
        return sent[0]['type'], {}
    return sent[0]['status'], {name.decode(): value.decode() for name, value in sent[0]['headers']}


@pytest.fixture
def locked(monkeypatch):
    """Return an access control with a token; a wrong one costs no time here."""
    monkeypatch.setattr(access_control, 'WRONG_TOKEN_DELAY', 0.0)
    return AccessControl(studio_app, TOKEN)


@pytest.mark.parametrize('host', ['evil.example', 'localhost.evil.example:8000', '127.0.0.1.evil.example'])
def test_foreign_names_are_refused(host):
    """A page elsewhere can point its own name to this computer."""
    assert ask(AccessControl(studio_app), ('host', host))[0] == 403
    assert ask(AccessControl(studio_app), ('host', host), kind='websocket')[0] == 'websocket.close'


@pytest.mark.parametrize('host', ['127.0.0.1:8000', 'localhost', 'LOCALHOST:1', '[::1]:8000'])
def test_own_names_are_taken(host):
    """Of loopback all of them."""
    assert ask(AccessControl(studio_app), ('host', host))[0] == 200


@pytest.mark.parametrize('origin', ['http://evil.example', 'null', 'http://127.0.0.1:9999'])
@pytest.mark.parametrize('kind', ['http', 'websocket'])
def test_requests_of_foreign_pages_are_refused(origin, kind):
    """Pages, uploads and the websocket alike."""
    assert ask(AccessControl(studio_app), HOST, ('origin', origin), kind=kind)[0] in (403, 'websocket.close')


def test_the_own_page_is_taken():
    """By page and websocket."""
    own = ('origin', 'http://127.0.0.1:8000')
    assert ask(AccessControl(studio_app), HOST, own)[0] == 200
    assert ask(AccessControl(studio_app), HOST, own, kind='websocket')[0] == 'websocket.accept'


@pytest.mark.parametrize(('header', 'value'), [
    ('host', '[::1'), ('host', ''), ('host', 'localhost:x'), ('host', 'a@localhost'), ('host', 'localhost/a'),
    ('host', '\xff'), ('origin', 'http://[::1'), ('origin', 'nowhere'), ('origin', 'http://127.0.0.1:8000\r\nx: 1')])
def test_malformed_headers_are_refused_in_one_line(header, value, caplog):
    """Without a traceback, for page and websocket."""
    headers = [HOST, (header, value)] if header == 'origin' else [(header, value)]
    assert ask(AccessControl(studio_app, names=None), *headers)[0] == 400
    assert ask(AccessControl(studio_app, names=None), *headers, kind='websocket')[0] == 'websocket.close'
    assert [line.count(f'refused: {header}: expected one as browsers send it') for line in caplog.messages] == [1, 1]


def test_two_hosts_are_none():
    """The server and a proxy before it could take different ones."""
    assert ask(AccessControl(studio_app), HOST, ('host', 'localhost'))[0] == 400


@pytest.mark.parametrize('path', ['/\ufffd', '/\x00', '/a\r\nb', '/\x1b[2J'])
def test_paths_are_text(path):
    """The server decodes what stands in the address."""
    assert ask(AccessControl(studio_app), HOST, path=path)[0] == 400


def test_parts_of_foreign_pages_are_refused():
    """An image from elsewhere is no page; a link from elsewhere is followed, and an old browser says nothing."""
    def fetched(site, destination):
        return ask(AccessControl(studio_app), HOST, ('sec-fetch-site', site), ('sec-fetch-dest', destination))[0]

    assert [fetched(site, 'image') for site in ('cross-site', 'same-site', 'same-origin')] == [403, 403, 200]
    assert [fetched(site, 'document') for site in ('cross-site', 'same-site', 'none')] == [200] * 3


def test_the_browser_connects_to_the_studio_only():
    """No websocket of another address."""
    policy = ask(AccessControl(studio_app), HOST)[1]['content-security-policy']
    assert "connect-src 'self';" in policy


def test_wrong_tokens_do_not_delay_the_right_one(monkeypatch):
    """However many are waiting for their answer."""
    monkeypatch.setattr(access_control, 'WRONG_TOKEN_DELAY', 3600.0)
    locked, answers = AccessControl(studio_app, TOKEN), []

    async def get(token):
        async def send(message):
            answers.append((token, message.get('status')))

        await locked({'type': 'http', 'path': '/', 'query_string': f'token={token}'.encode(), 'method': 'GET',
                      'headers': [(b'host', b'127.0.0.1')]}, None, send)

    async def attack():
        wrong = [asyncio.create_task(get('wrong')) for _ in range(50)]
        await asyncio.sleep(0)
        await asyncio.wait_for(get(TOKEN), 300)
        for one in wrong:
            one.cancel()

    with ThreadPoolExecutor(1) as thread:
        thread.submit(asyncio.run, attack()).result()
    assert answers[0] == (TOKEN, 303)


def test_bodies_are_bounded():
    """By what they say, and by what comes."""
    assert ask(AccessControl(studio_app), HOST, ('content-length', str(MOST_BODY + 1)))[0] == 413
    assert ask(AccessControl(studio_app), HOST, ('content-length', 'many'))[0] == 413
    assert ask(AccessControl(studio_app), HOST, ('content-length', '²'))[0] == 413
    part = bytes(1 << 24)
    assert ask(AccessControl(studio_app), HOST, body=[part] * 12)[0] == 200
    assert ask(AccessControl(studio_app), HOST, body=[part] * 13)[0] == 413


@pytest.mark.parametrize(('requested', 'status', 'answer'), [
    ([], 499, b''), ([{'body': b'a', 'more_body': True}], 499, b''), ([{'body': b'a'}], 200, b'abc')])
def test_a_browser_that_goes_away_is_no_error(requested, status, answer):
    """No answer, or one cut short, would be one to the middlewares outside of the access control, as in NiceGUI."""
    async def studio(scope, receive, send):
        body = await Request(scope, receive).body()

        async def parts():
            for part in (body, b'b', b'c'):
                await asyncio.sleep(0.01)
                yield part

        await StreamingResponse(parts())(scope, receive, send)

    async def call_next(request, answer):
        return await answer(request)

    sent, received = [], iter({'type': 'http.request', **message} for message in requested)

    async def receive():
        return next(received, {'type': 'http.disconnect'})

    async def send(message):
        sent.append(message)

    made = BaseHTTPMiddleware(GZipMiddleware(AccessControl(studio)), call_next)
    scope = {'type': 'http', 'path': '/', 'query_string': b'', 'method': 'GET', 'headers': [(b'host', b'127.0.0.1')]}
    with ThreadPoolExecutor(1) as thread:
        thread.submit(asyncio.run, made(scope, receive, send)).result()
    assert sent[0]['status'] == status
    assert b''.join(message.get('body', b'') for message in sent) == answer


@pytest.mark.parametrize('kind', ['http', 'websocket'])
@pytest.mark.parametrize('path', ['/', '/_nicegui/client/x/upload/1', '/_nicegui_ws/socket.io'])
def test_without_the_token_nothing_is_reached(locked, path, kind):
    """Page, upload, websocket."""
    assert ask(locked, HOST, path=path, kind=kind)[0] in (401, 'websocket.close')
    assert ask(locked, HOST, ('cookie', f'{COOKIE}8000={TOKEN}'), path=path, kind=kind)[0] in (401, 'websocket.close')


def test_the_token_in_the_address_gives_a_cookie(locked):
    """And the address without it; other parts of the query stay; the cookie opens all."""
    status, headers = ask(locked, HOST, query=f'token={TOKEN}&x=1'.encode())
    assert (status, headers['location']) == (303, '/?x=1')
    assert 'HttpOnly' in headers['set-cookie'] and 'SameSite' in headers['set-cookie']
    assert TOKEN not in headers['set-cookie']
    cookie = ('cookie', headers['set-cookie'].partition(';')[0])
    assert ask(locked, HOST, cookie)[0] == 200
    assert ask(locked, HOST, cookie, kind='websocket')[0] == 'websocket.accept'
    assert ask(locked, HOST, ('cookie', cookie[1] + 'x'))[0] == 401


def test_studios_on_one_computer_have_cookies_of_their_own():
    """A browser sends those of all ports to each of them."""
    studios = {host: AccessControl(studio_app, TOKEN) for host in ('127.0.0.1:8000', '127.0.0.1:8001', '127.0.0.1')}
    cookies = {}
    for host, studio in studios.items():
        headers = ask(studio, ('host', host), query=f'token={TOKEN}'.encode())[1]
        name, _, cookies[name] = headers['set-cookie'].partition(';')[0].partition('=')
    sent = '; '.join(f'{name}={value}' for name, value in cookies.items())
    assert [ask(studio, ('host', host), ('cookie', sent))[0] for host, studio in studios.items()] == [200] * 3


def test_the_form_takes_the_token(locked):
    """Wrong ones show the page again."""
    form = {'path': SIGN_IN_PATH, 'method': 'POST'}
    assert ask(locked, HOST, body=[b'token=', TOKEN.encode()], **form)[1]['location'] == '/'
    assert ask(locked, HOST, body=[b'token=wrong'], **form)[0] == 401
    assert ask(locked, HOST, body=[b'x' * 5000], **form)[0] == 401


def test_no_redirection_leads_elsewhere(locked):
    """A path with two slashes would be another host."""
    assert ask(locked, HOST, path='//evil.example', query=f'token={TOKEN}'.encode())[1]['location'] == '/evil.example'


@pytest.mark.parametrize(('arguments', 'words'), [
    (['--host', '0.0.0.0'], 'others can reach this address; expected a token with it'),
    (['--token', 'short'], 'expected at least 12 printable ASCII characters'),
    (['--host', 'here'], 'expected an IP address'),
    (['nothing.csv'], 'nothing.csv: expected a log directory'),
])
def test_the_command_line_refuses(arguments, words, capsys, monkeypatch):
    """Before anything is served."""
    monkeypatch.delenv('ROSETTE_STUDIO_TOKEN', raising=False)
    assert main(['studio', '--no-browser', *arguments]) == 2
    assert words in capsys.readouterr().err


def test_the_page_asks_for_the_token(chromium, start_studio, tmp_path):
    """A wrong one is refused, the right one leads to the page, websocket included."""
    with start_studio(tmp_path, '--host', '127.0.0.1', environment={'ROSETTE_STUDIO_TOKEN': TOKEN}) as studio:
        context = chromium.new_context()
        page = context.new_page()
        page.goto(studio.address)
        page.get_by_label('Token').fill('wrong')
        page.keyboard.press('Enter')
        expect(page.get_by_role('alert')).to_have_text('This is not the token.')
        page.get_by_label('Token').fill(TOKEN)
        page.keyboard.press('Enter')
        expect(page.get_by_test_id('open-path')).to_be_visible()
        assert TOKEN not in page.url
        context.close()
    assert os.listdir(tmp_path) == ['studio.log']
