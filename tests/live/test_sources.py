"""Files that grow, are rotated and truncated; sockets that close; addresses."""

import functools
import math
import os
import socket
import threading
import time

import pytest

from pinav.errors import InputError
from pinav.live import sources


def lines_of(source, looks=6, most=math.inf, answer=lambda: None):
    """Lines and texts of some looks, or until there are so many; each is answered."""
    buffer, lines, texts = sources.LineBuffer(), [], []
    for _ in range(looks):
        reading = source.read(0.01)
        buffer = sources.LineBuffer() if reading.fresh else buffer
        buffer, more = buffer.after(reading.data)
        lines += more
        texts += [reading.text] if reading.text else []
        if more:
            answer()
        if len(lines) >= most:
            break
    return lines, texts


@pytest.fixture
def followed(tmp_path):
    source = sources.FileSource(tmp_path / "frames")
    yield source
    source.close()


def test_a_file_is_followed_from_before_it_exists_by_whole_lines(followed):
    source, path = followed, followed.path
    assert lines_of(source, 2) == ([], [])
    path.write_bytes(b"one\ntw")
    data = source.read(0.0).data + source.read(0.0).data
    buffer, lines = sources.LineBuffer().after(data)
    assert lines == [b"one"]
    with path.open("ab") as file:
        file.write(b"o\n")
    assert buffer.after(source.read(0.0).data)[1] == [b"two"]


def test_a_rotated_file_is_read_to_its_end_and_a_truncated_one_from_its_start(followed):
    source, path = followed, followed.path
    path.write_bytes(b"one\n")
    assert lines_of(source)[0] == [b"one"]
    with path.open("ab") as file:
        os.rename(path, path.with_name("old"))
        path.write_bytes(b"three\n")
        file.write(b"two\n")
    lines, (text,) = lines_of(source)
    assert lines == [b"two", b"three"]
    assert "rotated" in text
    path.write_bytes(b"one\ntwo\n")
    lines_of(source)
    path.write_bytes(b"3\n")
    lines, (text,) = lines_of(source)
    assert lines == [b"3"]
    assert "truncated" in text


def serve(server, *parts):
    """Accept once for each part, send it and close; what was heard is returned."""
    heard = []

    def run():
        for part in parts:
            peer, _ = server.accept()
            peer.sendall(part)
            peer.settimeout(0.3)
            try:
                heard.append(peer.recv(100))
            except TimeoutError:
                heard.append(b"")
            peer.close()

    thread = threading.Thread(target=run)
    thread.start()
    return thread, heard


def test_a_socket_is_tried_again_and_answered():
    with socket.create_server(("127.0.0.1", 0)) as server:
        thread, heard = serve(server, b"one\nhal", b"two\n")
        source = sources.SocketSource(*server.getsockname())
        sink = sources.sink_of(None, source)
        assert sink is source
        answer = functools.partial(sink.write, b"answer\n")
        lines, texts = lines_of(source, looks=500, most=2, answer=answer)
        thread.join(5)
        source.close()
    assert lines == [b"one", b"two"]
    assert heard == [b"answer\n", b"answer\n"]
    assert [text.split()[0] for text in texts] == ["connected", "the", "connected"]


def test_a_socket_that_is_not_there_yet_waits_longer_each_time():
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
    source = sources.SocketSource("127.0.0.1", port)
    assert source.read(0.0).data == b""
    waits = []
    for _ in range(8):
        waits.append(source.connection.due - time.monotonic())
        source.connection.due = 0.0
        source.read(0.0)
    assert waits == pytest.approx([0.1, 0.2, 0.4, 0.8, 1.6, 3.2, 5.0, 5.0], abs=0.05)
    source.write(b"lost\n")  # nobody listens, nothing is raised


def test_standard_input_ends(tmp_path):
    read, write = os.pipe()
    os.write(write, b"one\n")
    source = sources.StreamSource(read)
    assert source.read(0.1).data == b"one\n"
    assert source.read(0.0).data == b""
    os.close(write)
    assert source.read(0.1).ended
    os.close(read)
    assert isinstance(sources.source_of("-"), sources.StreamSource)


def test_commands_go_to_a_file_or_another_connection(tmp_path):
    path = tmp_path / "commands"
    sink = sources.sink_of(str(path), sources.FileSource(path))
    assert isinstance(sink, sources.FileSink)
    sink.write(b"one\n")
    sink.write(b"two\n")
    assert path.read_bytes() == b"one\ntwo\n"
    with socket.create_server(("127.0.0.1", 0)) as server:
        thread, heard = serve(server, b"")
        port = server.getsockname()[1]
        other = sources.sink_of(f"tcp://127.0.0.1:{port}", sources.FileSource(path))
        assert isinstance(other, sources.SocketSink)
        other.write(b"command\n")
        thread.join(5)
    assert heard == [b"command\n"]
    for _ in range(3):
        other.write(b"into the void\n")  # dropped, not raised


@pytest.mark.parametrize(
    "text", ["tcp://", "tcp://host", "udp://a:1", "tcp://a:65536", "tcp://:80"]
)
def test_a_damaged_address_is_refused(text):
    with pytest.raises(InputError, match="expected tcp://HOST:PORT"):
        sources.address_of(text, "")


def test_another_machine_needs_a_secret():
    with pytest.raises(InputError, match="shared secret; give its file by --token"):
        sources.address_of("tcp://10.0.0.5:5000", "")
    assert sources.address_of("tcp://10.0.0.5:5000", "secret-secret") == (
        "10.0.0.5",
        5000,
    )
    assert sources.address_of("tcp://[::1]:5000", "") == ("::1", 5000)
    assert sources.address_of("tcp://localhost:65535", "") == ("localhost", 65535)
    assert sources.address_of("frames.jsonl", "") is None
