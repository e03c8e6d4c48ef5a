"""The adapter against recorded events, and a Slack, a Teams and a mail server on this machine."""

import base64
import contextlib
import email
import email.policy
import hashlib
import hmac
import http.client
import http.server
import io
import json
import os
import pathlib
import socketserver
import ssl
import sys
import tempfile
import threading
import time
import unittest
import unittest.mock

HERE = pathlib.Path(__file__).parent
sys.path.insert(0, str(HERE.parent.parent / "deploy" / "notify"))
import mapshift_notify as notify

SECRET = "whsec_AAECAwQFBgcICQoLDA0ODxAREhMUFRYXGBkaGxwdHh8="
OTHER = "whsec_" + base64.b64encode(b"x" * 32).decode()
EVENTS = json.loads((HERE / "events.json").read_text())


def golden(name, made):
    """What was made and what is kept, as texts; GOLDEN=write keeps what was made."""
    path = HERE / "golden" / name
    text = made if isinstance(made, str) else json.dumps(made, indent=1, ensure_ascii=False) + "\n"
    if os.environ.get("GOLDEN") == "write":
        path.write_text(text)
    return text, path.read_text()


def signed(body, message_id="msg_1", secret=SECRET, now=None):
    timestamp = str(int(time.time() if now is None else now))
    key = base64.b64decode(secret.removeprefix("whsec_"))
    code = hmac.new(key, f"{message_id}.{timestamp}.".encode() + body, hashlib.sha256).digest()
    signature = "v1," + base64.b64encode(code).decode()
    return {"webhook-id": message_id, "webhook-timestamp": timestamp, "webhook-signature": signature}


class Chat(http.server.BaseHTTPRequestHandler):
    """Keeps what it is posted; answers with the status that is set for the path, None being no status line."""

    def do_POST(self):
        body = self.rfile.read(int(self.headers["content-length"]))
        status = self.server.statuses.get(self.path, 200)
        if status is None:
            return self.wfile.write(b"no HTTP\r\n\r\n")
        if status == 200:
            self.server.posted.append((self.path, json.loads(body)))
        self.answer(status)

    def do_GET(self):
        self.server.posted.append((self.path, "GET"))
        self.answer(200)

    def answer(self, status):
        self.send_response(status)
        if status // 100 == 3:
            self.send_header("location", "/elsewhere")
        self.send_header("content-length", "0")
        self.end_headers()

    def log_message(self, *_):
        pass


class Smtp(socketserver.StreamRequestHandler):
    """As much of a mail server as takes a message."""

    def handle(self):
        say = lambda line: self.wfile.write(line + b"\r\n")
        say(b"220 here")
        while line := self.rfile.readline():
            verb = line.split()[0].upper()
            if verb == b"DATA":
                say(b"354 go on")
                lines = []
                while (one := self.rfile.readline()) != b".\r\n":
                    lines.append(one)
                self.server.mails.append(b"".join(lines))
            if verb == b"QUIT":
                return say(b"221 bye")
            say(b"250 ok")


class Adapter(unittest.TestCase):
    def setUp(self):
        self.directory = tempfile.TemporaryDirectory()
        self.addCleanup(self.directory.cleanup)
        self.chat = self.serve(http.server.ThreadingHTTPServer(("127.0.0.1", 0), Chat))
        self.chat.posted, self.chat.statuses = [], {}
        self.smtp = self.serve(socketserver.ThreadingTCPServer(("127.0.0.1", 0), Smtp))
        self.smtp.mails = []
        self.start()

    def serve(self, server):
        server.daemon_threads = True
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
        thread.start()
        self.addCleanup(lambda: (server.shutdown(), server.server_close(), thread.join()))
        return server

    def settings(self, **changed):
        url = f"http://127.0.0.1:{self.chat.server_address[1]}"
        environment = {
            "LISTEN": "127.0.0.1:0", "SECRETS": f"{OTHER} {SECRET}", "STATE": self.directory.name + "/taken.db",
            "SLACK_URL": url + "/slack", "TEAMS_URL": url + "/teams",
            "SMTP": f"127.0.0.1:{self.smtp.server_address[1]}", "SMTP_SECURITY": "none",
            "MAIL_FROM": "mapshift@example.com", "MAIL_TO": "a@example.com b@example.com",
        }
        environment.update(changed)
        return notify.Settings({"MAPSHIFT_NOTIFY_" + name: value for name, value in environment.items()})

    def start(self):
        self.adapter = self.serve(notify.server(self.settings()))

    def send(self, event, headers=None, **how):
        body = json.dumps(event).encode()
        connection = http.client.HTTPConnection("127.0.0.1", self.adapter.server_address[1], timeout=10)
        connection.request("POST", "/", body, signed(body, **how) if headers is None else headers)
        status = connection.getresponse().status
        connection.close()
        return status

    def counts(self):
        paths = [path for path, _ in self.chat.posted]
        return paths.count("/slack"), paths.count("/teams"), len(self.smtp.mails)

    def test_every_event_becomes_the_message_that_is_kept(self):
        for number, (name, event) in enumerate(EVENTS.items()):
            self.chat.posted.clear()
            self.smtp.mails.clear()
            self.assertEqual(self.send(event, message_id=f"msg_{number}"), 204)
            (_, slack), (_, teams) = self.chat.posted
            message = email.message_from_bytes(self.smtp.mails[0], policy=email.policy.default)
            heads = [f"{head}: {message[head]}" for head in ("Subject", "From", "To", "Message-ID")]
            text = "\n".join(heads) + "\n\n" + message.get_content().replace("\r\n", "\n")
            for suffix, made in (("slack.json", slack), ("teams.json", teams), ("mail.txt", text)):
                with self.subTest(event=name, channel=suffix):
                    self.assertEqual(*golden(f"{name}.{suffix}", made))

    def test_only_what_mapshift_signed_lately_is_forwarded(self):
        event = EVENTS["alert.raised"]
        body = json.dumps(event).encode()
        good = signed(body)
        for headers in (
            {}, signed(body + b" "), signed(body, secret="whsec_" + base64.b64encode(b"y" * 32).decode()),
            signed(body, now=time.time() - 301), signed(body, now=time.time() + 301),
            {**good, "webhook-id": "msg_2"}, {**good, "webhook-timestamp": "soon"},
            {**good, "webhook-signature": "v1,"},
        ):
            self.assertEqual(self.send(event, headers), 401, headers)
        self.assertEqual(self.counts(), (0, 0, 0))
        # While a secret is replaced there are two signatures, of which the adapter may know one.
        both = {**good, "webhook-signature": "v1,bm8= " + good["webhook-signature"]}
        self.assertEqual(self.send(event, both), 204)
        self.assertEqual(self.counts(), (1, 1, 1))

    def test_an_event_is_forwarded_once_also_after_a_restart(self):
        event = EVENTS["alert.raised"]
        self.assertEqual([self.send(event), self.send(event)], [204, 204])
        self.start()
        self.assertEqual(self.send(event), 204)
        self.assertEqual(self.counts(), (1, 1, 1))
        self.assertEqual(self.send(event, message_id="msg_2"), 204)
        self.assertEqual(self.counts(), (2, 2, 2))

    def test_what_a_channel_does_not_take_is_sent_to_it_alone_when_mapshift_repeats_it(self):
        event = EVENTS["alert.raised"]
        self.chat.statuses["/slack"] = 500
        with contextlib.redirect_stderr(io.StringIO()):
            self.assertEqual([self.send(event), self.send(event)], [503, 503])
        self.assertEqual(self.counts(), (0, 1, 1))
        self.chat.statuses.clear()
        self.assertEqual(self.send(event), 204)
        self.assertEqual(self.counts(), (1, 1, 1))

    def test_a_redirect_and_an_answer_that_is_none_are_no_acceptance(self):
        event = EVENTS["alert.raised"]
        for number, status in enumerate((301, 302, 303, 307, 308, None)):
            self.chat.statuses["/slack"] = status
            with contextlib.redirect_stderr(io.StringIO()) as log:
                self.assertEqual(self.send(event, message_id=f"msg_{number}"), 503, status)
            self.assertIn("slack did not take", log.getvalue())
            self.assertEqual(self.counts(), (0, number + 1, number + 1))
        self.assertNotIn("/elsewhere", [path for path, _ in self.chat.posted])

    def test_an_event_that_is_not_understood_is_asked_for_again(self):
        with contextlib.redirect_stderr(io.StringIO()) as log:
            self.assertEqual(self.send({"type": "alert.raised", "data": {}}), 500)
        self.assertIn("an event was not forwarded: KeyError", log.getvalue())
        self.assertEqual(self.send(EVENTS["alert.raised"]), 204)

    def test_a_mail_server_has_to_prove_its_name(self):
        for security in ("tls", "starttls"):
            settings = self.settings(SMTP_SECURITY=security)
            with unittest.mock.patch("smtplib.SMTP"), unittest.mock.patch("smtplib.SMTP_SSL"):
                settings.send("mail", notify.note_of(EVENTS["alert.raised"]), "msg_1")
                if security == "tls":
                    context = notify.smtplib.SMTP_SSL.call_args.kwargs["context"]
                else:
                    server = notify.smtplib.SMTP.return_value.__enter__.return_value
                    context = server.starttls.call_args.kwargs["context"]
            self.assertTrue(context.check_hostname)
            self.assertEqual(context.verify_mode, ssl.CERT_REQUIRED)

    def test_settings_that_cannot_work_are_refused_at_the_start(self):
        for changed in (
            {"SECRETS": ""}, {"SECRETS": "whsec_?"}, {"SLACK_URL": "", "TEAMS_URL": "", "SMTP": ""},
            {"MAIL_TO": ""}, {"SMTP_SECURITY": "ssl"},
        ):
            with self.assertRaises(SystemExit, msg=changed):
                self.settings(**changed)


if __name__ == "__main__":
    unittest.main()
