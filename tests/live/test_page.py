"""The page is served on the loopback alone, and streams what is said."""

import http.client
import json
import re

import pytest

from pinav.live.messages import Command, Event, EventKind, Mode, State
from pinav.live.page import HOST, Lines, Page, Places, document

STATE = State(seq=1, t=0.5, mode=Mode.STEERING, x=1.0, y=2.0, sd=0.1)


def get(page, path, host=None):
    port = int(page.address.rsplit(":", 1)[1].rstrip("/"))
    connection = http.client.HTTPConnection(HOST, port, timeout=5)
    connection.request("GET", path, headers={"Host": host} if host else {})
    return connection, connection.getresponse()


@pytest.fixture
def page():
    with Page.serve(0, Places((1.0, 2.0), ((3.0, 4.0, 5.0),))) as served:
        yield served


def test_the_page_holds_the_places_and_runs_its_own_script_alone(page):
    connection, answer = get(page, "/")
    text = answer.read().decode()
    assert '{"goal":[1.0,2.0],"keep_out":[[3.0,4.0,5.0]]}' in text
    policy = answer.headers["Content-Security-Policy"]
    assert policy.startswith("default-src 'none'; script-src 'sha256-")
    assert "unsafe" not in policy
    assert not re.search(r"https?://", text)
    connection.close()
    assert b"</script><" not in document(Places())[0].split(b"<script>")[1][:200]


def test_states_and_events_are_streamed_and_commands_are_not(page):
    page.show(STATE)
    page.show(Command(seq=1, for_t=0.5, frequency=1.0, heading=0.0, valid_until=1.0))
    page.show(Event(t=None, kind=EventKind.LAG, text="</script>"))
    connection, answer = get(page, "/events")
    lines = [answer.readline() for _ in range(4)]
    messages = [json.loads(line[6:]) for line in lines if line.startswith(b"data: ")]
    assert [message["type"] for message in messages] == ["state", "event"]
    connection.close()


def test_other_names_and_places_are_refused(page):
    for path, host, status in [("/", "evil.example", 403), ("/etc/passwd", None, 404)]:
        connection, answer = get(page, path, host)
        assert answer.status == status
        answer.read()
        connection.close()


def test_a_late_browser_gets_the_last_lines():
    lines = Lines()
    for number in range(6000):
        lines.add(b"%d\n" % number)
    last, count, more = lines.after(0, 0.0)
    assert (len(last), count, more) == (5000, 6000, True)
    assert lines.after(count, 0.0)[0] == []
    lines.close()
    assert not lines.after(count, 1.0)[2]
