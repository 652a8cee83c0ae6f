"""One request in flight, deadlines, late and stale replies, lost connections."""

from __future__ import annotations

import os
import socket
import threading
import time
import tty
from collections.abc import Callable
from pathlib import Path

import pytest
from scripted_peer import Late, Peer

from drivers import transport
from drivers.errors import CommunicationError
from drivers.lines import ModbusSerialLineForm, SerialLineForm, TcpLineForm
from drivers.ports import SerialWire, TcpWire, is_pseudo_terminal, open_port
from drivers.transport import Line, NoReply, line_ends_with

Converse = Callable[..., Peer]
LF = line_ends_with(b"\n")


def serial_line(port: str, timeout: float = 0.3) -> Line:
    form = SerialLineForm(kind="serial", port=port, baudrate=57600, parity="E", xonxoff=True, rtscts=True)
    return Line("test-line", SerialWire(form), timeout)


def test_a_reply_is_returned_with_its_terminator(converse: Converse) -> None:
    peer = converse((b"who\n", b"me\n"))
    line = serial_line(peer.port)
    assert line.exchange("device", b"who\n", LF) == b"me\n"
    line.close()


@pytest.mark.parametrize("parity", ["N", "E", "O"])
def test_a_pseudo_terminal_opens_whatever_parity_and_flow_control_the_form_names(
    converse: Converse, parity: str
) -> None:
    peer = converse()
    assert is_pseudo_terminal(peer.port)
    form = ModbusSerialLineForm(kind="modbus-serial", port=peer.port, parity=parity, stopbits=2)
    open_port(form).close()


def test_xon_and_xoff_bytes_pass_a_pseudo_terminal(converse: Converse) -> None:
    data = bytes(byte for byte in range(256) if byte != 0x0A) + b"\n"
    peer = converse((data, data))
    line = serial_line(peer.port)
    assert line.exchange("device", data, LF) == data
    line.close()


def test_no_reply_names_device_line_request_and_time(converse: Converse) -> None:
    peer = converse((b"who\n", None))
    line = serial_line(peer.port, timeout=0.1)
    with pytest.raises(NoReply, match=r"arm: no reply to b'who\\n' on line 'test-line' within 0.1 s; nothing came"):
        line.exchange("arm", b"who\n", LF)
    line.close()


def test_a_torn_reply_is_quoted(converse: Converse) -> None:
    peer = converse((b"who\n", b"hal"))
    line = serial_line(peer.port, timeout=0.1)
    with pytest.raises(NoReply, match="only b'hal' came"):
        line.exchange("arm", b"who\n", LF)
    line.close()


def test_a_reply_that_comes_after_its_deadline_is_not_taken_for_the_next_one(
    converse: Converse, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(transport, "QUIET", 0.5)  # longer than a busy machine is late
    peer = converse((b"one\n", Late(0.4, b"1\n")), (b"two\n", b"2\n"))
    line = serial_line(peer.port, timeout=0.2)
    with pytest.raises(NoReply):
        line.exchange("arm", b"one\n", LF)
    assert line.exchange("arm", b"two\n", LF) == b"2\n"
    line.close()


def test_what_arrived_unasked_is_thrown_away(converse: Converse) -> None:
    peer = converse((b"one\n", b"1\n"))
    line = serial_line(peer.port)
    peer.send(b"noise\n")
    time.sleep(0.05)
    assert line.exchange("arm", b"one\n", LF) == b"1\n"
    line.close()


def test_a_deadline_is_kept_although_bytes_keep_coming(converse: Converse) -> None:
    peer = converse((b"one\n", b"x"))
    line = serial_line(peer.port, timeout=0.2)
    enough = threading.Event()

    def talk() -> None:
        while not enough.wait(0.01):
            peer.send(b"x")

    babble = threading.Thread(target=talk)
    babble.start()
    with pytest.raises(NoReply):  # without a deadline of its own the exchange would listen for ever
        line.exchange("arm", b"one\n", LF)
    enough.set()
    babble.join()
    line.close()


def test_a_lost_pseudo_terminal_is_reported_and_found_again(converse: Converse, tmp_path: Path) -> None:
    first, second = converse(), converse((b"two\n", b"2\n"))
    link = tmp_path / "line.tty"
    link.symlink_to(first.port)
    line = serial_line(str(link))
    first.hang_up()
    with pytest.raises(CommunicationError, match="connection lost on line 'test-line'"):
        line.exchange("arm", b"one\n", LF)
    with pytest.raises(CommunicationError):
        line.exchange("arm", b"one\n", LF)
    link.unlink()
    link.symlink_to(second.port)
    assert line.exchange("arm", b"two\n", LF) == b"2\n"
    line.close()


def test_a_lost_tcp_connection_is_reported_and_found_again() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        host, port = server.getsockname()
        line = TcpLineForm(kind="tcp", host=host, port=port, timeout=0.3).open("test-line")
        assert isinstance(line, Line)
        accepted, _ = server.accept()
        accepted.close()
        with pytest.raises(CommunicationError, match="connection lost"):
            line.exchange("arm", b"one\n", LF)

        def answer() -> None:
            again, _ = server.accept()
            with again:
                assert again.recv(100) == b"two\n"
                again.sendall(b"2\n")

        thread = threading.Thread(target=answer)
        thread.start()
        assert line.exchange("arm", b"two\n", LF) == b"2\n"
        thread.join()
        line.close()


def test_a_port_that_nobody_serves_is_an_os_error() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
    with pytest.raises(OSError, match="refused"):
        Line("test-line", TcpWire("127.0.0.1", port), 0.2)


def test_two_threads_never_have_requests_in_flight_together() -> None:
    master, slave = os.openpty()
    tty.setraw(slave)
    line = serial_line(os.ttyname(slave), timeout=2.0)
    overlaps: list[bytes] = []

    def serve() -> None:
        for _ in range(20):
            request = os.read(master, 100)
            if request.count(b"\n") != 1:
                overlaps.append(request)
            time.sleep(0.003)
            os.write(master, request)

    server = threading.Thread(target=serve)
    server.start()
    replies: list[tuple[bytes, bytes]] = []

    def ask(name: str) -> None:
        for index in range(10):
            request = f"{name}{index}\n".encode()
            replies.append((request, line.exchange(name, request, LF)))

    threads = [threading.Thread(target=ask, args=(name,)) for name in ("a", "b")]
    for thread in threads:
        thread.start()
    for thread in (*threads, server):
        thread.join()
    line.close()
    os.close(master)
    os.close(slave)
    assert not overlaps
    assert len(replies) == 20
    assert all(request == reply for request, reply in replies)


def test_the_last_device_that_leaves_closes_the_wire(converse: Converse) -> None:
    peer = converse((b"one\n", b"1\n"))
    line = serial_line(peer.port)
    line.attach("a")
    line.attach("b")
    line.release("a")
    assert line.exchange("b", b"one\n", LF) == b"1\n"
    line.release("b")
    line.release("b")
    with pytest.raises(CommunicationError, match="b: line 'test-line' is closed"):
        line.exchange("b", b"one\n", LF)


def test_a_port_locked_by_another_program_is_refused(converse: Converse) -> None:
    peer = converse()
    line = serial_line(peer.port)
    with pytest.raises(OSError, match="in use by another program"):
        serial_line(peer.port)
    line.close()
