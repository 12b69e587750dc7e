"""The server of a page: who gets it, once, and nothing else."""

import http.client
import socket
import threading

import pytest

from trabecula.core.errors import InputError
from trabecula.view.page import server
from trabecula.view.page.server import PageServer

HTML = "<!doctype html><title>page</title>"


@pytest.fixture
def page_server():
    with PageServer(HTML) as running:
        threading.Thread(target=running.serve_forever, args=(0.01,), daemon=True).start()
        yield running
        running.shutdown()


def ask(page_server, path, *, method="GET", **headers):
    connection = http.client.HTTPConnection("127.0.0.1", page_server.server_port, timeout=10)
    connection.request(
        method, path, headers={name.replace("_", "-"): value for name, value in headers.items()}
    )
    answer = connection.getresponse()
    body = answer.read().decode()
    connection.close()
    return answer, body


def test_the_token_opens_once_and_gives_a_cookie_that_opens_again(page_server):
    path = f"/?token={page_server.token}"
    answer, body = ask(page_server, path)
    assert answer.status == 303 and answer.headers["Location"] == "/" and body == ""
    kept = answer.headers["Set-Cookie"]
    assert "HttpOnly" in kept and "SameSite" in kept
    for _ in range(2):
        answer, body = ask(page_server, "/", Cookie=kept.split(";")[0])
        assert answer.status == 200 and body == HTML
    assert ask(page_server, path)[0].status == 403
    assert "token" not in page_server.url


@pytest.mark.parametrize("path", ["/", "/?token=", "/?token=guess", "/?token=%00", "/?other=1"])
def test_nobody_else_gets_it(page_server, path):
    answer, body = ask(page_server, path)
    assert answer.status == 403 and HTML not in body
    assert (
        ask(page_server, f"/?token={page_server.token}")[0].status == 303
    )  # a wrong guess spends nothing


@pytest.mark.parametrize(
    "path",
    ["/etc/passwd", "/../../etc/passwd", "/%2e%2e/etc/passwd", "//etc/passwd", "/index.html"],
)
def test_no_other_path_is_there(page_server, path):
    cookie = f"trabecula-{page_server.server_port}={page_server.cookie}"
    answer, body = ask(page_server, path, Cookie=cookie)
    assert answer.status == 404 and "root:" not in body


@pytest.mark.parametrize(
    "host", ["evil.example", "127.0.0.1", "127.0.0.1:1", "localhost.evil.example:80", ""]
)
def test_another_name_for_this_machine_is_refused(page_server, host):
    answer, _ = ask(page_server, f"/?token={page_server.token}", Host=host)
    assert answer.status == 403
    assert page_server.token is not None


@pytest.mark.parametrize("method", ["POST", "PUT", "DELETE", "OPTIONS", "HEAD"])
def test_nothing_can_be_sent(page_server, method):
    assert ask(page_server, "/", method=method)[0].status == 501


@pytest.mark.parametrize("cookie", ["trabecula=x", "=", "a=b; ;;", "\x01"])
def test_a_strange_cookie_is_no_cookie(page_server, cookie):
    assert ask(page_server, "/", Cookie=cookie)[0].status == 403


def test_it_listens_on_this_machine_alone(page_server):
    assert page_server.server_address[0] == "127.0.0.1"
    answer, _ = ask(page_server, "/")
    assert (
        answer.headers["X-Frame-Options"] == "DENY"
        and answer.headers["Cache-Control"] == "no-store"
    )


def test_a_taken_port_is_told():
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        with pytest.raises(InputError, match=f"port {port} cannot be used .*leave --port out"):
            PageServer(HTML, port=port)
    with pytest.raises(InputError, match=r"outside 0\.\.65535"):
        PageServer(HTML, port=70000)


@pytest.fixture
def no_waiting(monkeypatch):
    """Let `serve` return at once, as if it were interrupted."""

    def interrupt(self):
        raise KeyboardInterrupt

    monkeypatch.setattr(PageServer, "serve_forever", interrupt)


def test_without_a_browser_the_address_is_told(no_waiting, monkeypatch):
    monkeypatch.setattr(server, "has_display", lambda: False)
    lines = []
    server.serve(HTML, tell=lines.append)
    assert (
        "no browser was found" in lines[0]
        and "http://127.0.0.1:" in lines[0]
        and "?token=" in lines[0]
    )
    with pytest.raises(InputError, match=r"no browser was found.*save\(path\)"):
        server.serve(HTML)


def test_a_browser_is_opened_on_the_address_with_the_token(no_waiting, monkeypatch):
    opened, lines = [], []
    monkeypatch.setattr(server, "has_display", lambda: True)
    monkeypatch.setattr(server.webbrowser, "open", lambda url: opened.append(url) or True)
    server.serve(HTML, tell=lines.append)
    assert "?token=" in opened[0] and "token" not in lines[0]
