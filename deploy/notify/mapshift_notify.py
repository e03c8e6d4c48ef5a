#!/usr/bin/env python3
"""Forwards mapshift's webhooks to Slack, Microsoft Teams and e-mail. Needs nothing but Python 3.9.

An event is answered with 204 once every channel has taken it, else with 503 (500 after an error of this
program): mapshift then sends it again, and only the channels that have not taken it are tried again. What
was forwarded is remembered by `webhook-id` in a small database, so that a repetition is not posted twice.

Configured by the environment; docs/how-to/notify-a-chat.md explains it.
"""

import base64
import binascii
import hashlib
import hmac
import http.client
import json
import os
import smtplib
import sqlite3
import ssl
import sys
import threading
import time
from email.message import EmailMessage
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from urllib.parse import urlsplit
from urllib.request import HTTPRedirectHandler, Request, build_opener

AGE_MAX_S = 300
BODY_MAX = 4 << 20
# Within the 15 s that mapshift waits for an answer.
CHANNEL_TIMEOUT_S = 4
# mapshift tries an event for 28 hours.
REMEMBERED_S = 7 * 24 * 3600


class Refused(Exception):
    """A call that is not mapshift's, or too old."""


def verify(headers, body, secrets, now):
    """Checks the signature as Standard Webhooks has it; several signatures and secrets while one is replaced."""
    try:
        message_id, timestamp = headers["webhook-id"], headers["webhook-timestamp"]
        signatures, age_s = headers["webhook-signature"].split(), now - int(timestamp)
    except (AttributeError, TypeError, ValueError):
        raise Refused("webhook-id, webhook-timestamp and webhook-signature are needed") from None
    if not message_id or abs(age_s) > AGE_MAX_S:
        raise Refused("the call is too old, or a clock is wrong")
    signed = message_id.encode() + b"." + timestamp.encode() + b"." + body
    for secret in secrets:
        key = base64.b64decode(secret.removeprefix("whsec_"))
        code = base64.b64encode(hmac.new(key, signed, hashlib.sha256).digest()).decode()
        if any(hmac.compare_digest(("v1," + code).encode(), one.encode()) for one in signatures):
            return message_id
    raise Refused("no signature is right")


def note_of(event):
    """What people are shown of an event: a title, a sentence, facts, and links by name."""
    kind, data, url = event["type"], event["data"], event.get("url")
    facts, links = {"Route": data.get("route_id")}, {"Open in mapshift": url}
    title, text = kind, ""
    if kind.startswith("alert."):
        place = data["location"]
        title, text = data["title"], data["summary"]
        facts["Place"] = "x {x:.2f} m, y {y:.2f} m".format(**place)
        facts["Status"] = "{status}, {tier}".format(**data)
        facts["Vehicles"] = ", ".join(data["vehicle_ids"])
        if url:
            origin = "{0.scheme}://{0.netloc}".format(urlsplit(url))
            links["Picture of the evidence"] = f"{origin}/v1/alerts/{data['id']}/evidence.svg"
    elif kind == "batch.quarantined":
        title, text = f"Batch {data['id']} was kept out of the map", data["reason"] or ""
        facts["Vehicle"] = data["vehicle_id"]
    elif kind == "vehicle.suspect":
        title, text = f"Vehicle {data['id']} is {data['state']}", "; ".join(data["reasons"])
    elif kind == "operation.finished":
        title, text = f"Operation {data['kind']}: {data['status']}", data["reason"] or ""
        facts["Operation"] = data["id"]
    elif kind == "webhook.test":
        title, text = "Test from mapshift", "Events will arrive here."
    kept = lambda entries: {name: value for name, value in entries.items() if value}
    return {"title": title, "text": text, "facts": kept(facts), "links": kept(links)}


def slack(note):
    """The payload of an incoming webhook."""
    escaped = lambda text: text.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")
    plain = lambda text: {"type": "plain_text", "text": text[:150]}
    blocks = [{"type": "header", "text": plain(note["title"])}]
    if note["text"]:
        blocks.append({"type": "section", "text": {"type": "mrkdwn", "text": escaped(note["text"])[:3000]}})
    facts = [f"*{name}:* {escaped(value)}" for name, value in note["facts"].items()]
    links = [f"<{url}|{name}>" for name, url in note["links"].items()]
    elements = [{"type": "mrkdwn", "text": text[:2000]} for text in facts + links]
    if elements:
        blocks.append({"type": "context", "elements": elements})
    return {"text": escaped(note["title"]), "blocks": blocks}


def teams(note):
    """The payload of a workflow that posts what it is sent: an Adaptive Card."""
    block = lambda text, **more: {"type": "TextBlock", "text": text, "wrap": True, **more}
    body = [block(note["title"], size="Medium", weight="Bolder")]
    if note["text"]:
        body.append(block(note["text"]))
    facts = [{"title": name, "value": value} for name, value in note["facts"].items()]
    if facts:
        body.append({"type": "FactSet", "facts": facts})
    card = {
        "$schema": "http://adaptivecards.io/schemas/adaptive-card.json",
        "type": "AdaptiveCard",
        "version": "1.4",
        "body": body,
        "actions": [{"type": "Action.OpenUrl", "title": name, "url": url} for name, url in note["links"].items()],
    }
    kind = "application/vnd.microsoft.card.adaptive"
    return {"type": "message", "attachments": [{"contentType": kind, "contentUrl": None, "content": card}]}


def mail(note, message_id, sender, recipients):
    """A plain e-mail. Its id is that of the event: mail programs show a repetition once."""
    message = EmailMessage()
    message["Subject"] = "mapshift: " + " ".join(note["title"].split())
    message["From"], message["To"] = sender, ", ".join(recipients)
    message["Message-ID"] = f"<{message_id}@mapshift>"
    lines = [note["text"], ""] + [f"{name}: {value}" for name, value in note["facts"].items()]
    lines += [""] + [f"{name}: {url}" for name, url in note["links"].items()]
    message.set_content("\n".join(lines).strip() + "\n")
    return message


class NoRedirects(HTTPRedirectHandler):
    """Followed, a redirect would be a GET without the payload: it is an error."""
    redirect_request = lambda *_: None


def post(url, payload):
    """Posts JSON; an exception unless the answer is 2xx."""
    data, headers = json.dumps(payload).encode(), {"content-type": "application/json"}
    with build_opener(NoRedirects).open(Request(url, data, headers), timeout=CHANNEL_TIMEOUT_S):
        pass


class Settings:
    """What the environment says."""

    def __init__(self, environment):
        get = lambda name, default="": environment.get(name, default)
        host, _, port = get("MAPSHIFT_NOTIFY_LISTEN", "127.0.0.1:8090").rpartition(":")
        self.listen = (host.strip("[]"), int(port))
        self.secrets = get("MAPSHIFT_NOTIFY_SECRETS").split()
        self.state = get("MAPSHIFT_NOTIFY_STATE", "mapshift-notify.db")
        self.slack_url, self.teams_url = get("MAPSHIFT_NOTIFY_SLACK_URL"), get("MAPSHIFT_NOTIFY_TEAMS_URL")
        self.smtp, self.smtp_security = get("MAPSHIFT_NOTIFY_SMTP"), get("MAPSHIFT_NOTIFY_SMTP_SECURITY", "starttls")
        self.smtp_user, self.smtp_password = get("MAPSHIFT_NOTIFY_SMTP_USER"), get("MAPSHIFT_NOTIFY_SMTP_PASSWORD")
        self.mail_from, self.mail_to = get("MAPSHIFT_NOTIFY_MAIL_FROM"), get("MAPSHIFT_NOTIFY_MAIL_TO").split()
        channels = {"slack": self.slack_url, "teams": self.teams_url, "mail": self.smtp}
        self.channels = [name for name, target in channels.items() if target]
        self.check()

    def check(self):
        """Exits with what is missing."""
        if not self.secrets:
            sys.exit("MAPSHIFT_NOTIFY_SECRETS is missing: the secret (whsec_…) of the webhook")
        try:
            [base64.b64decode(secret.removeprefix("whsec_"), validate=True) for secret in self.secrets]
        except binascii.Error:
            sys.exit("MAPSHIFT_NOTIFY_SECRETS holds something that is no secret (whsec_ and base64)")
        if not self.channels:
            sys.exit("nowhere to send to: set MAPSHIFT_NOTIFY_SLACK_URL, MAPSHIFT_NOTIFY_TEAMS_URL or MAPSHIFT_NOTIFY_SMTP")
        if self.smtp and not (self.mail_from and self.mail_to):
            sys.exit("MAPSHIFT_NOTIFY_SMTP needs MAPSHIFT_NOTIFY_MAIL_FROM and MAPSHIFT_NOTIFY_MAIL_TO")
        if self.smtp_security not in ("starttls", "tls", "none"):
            sys.exit("MAPSHIFT_NOTIFY_SMTP_SECURITY is starttls, tls or none")

    def send(self, channel, note, message_id):
        """Sends to one channel; an exception unless it took the message."""
        if channel == "slack":
            return post(self.slack_url, slack(note))
        if channel == "teams":
            return post(self.teams_url, teams(note))
        host, _, port = self.smtp.partition(":")
        tls, context = self.smtp_security == "tls", {"context": ssl.create_default_context()}
        client, more = (smtplib.SMTP_SSL, context) if tls else (smtplib.SMTP, {})
        with client(host, int(port or 0), timeout=CHANNEL_TIMEOUT_S, **more) as server:
            if self.smtp_security == "starttls":
                server.starttls(**context)
            if self.smtp_user:
                server.login(self.smtp_user, self.smtp_password)
            server.send_message(mail(note, message_id, self.mail_from, self.mail_to))


class Forwarder:
    """Forwards events, and remembers which channel has taken which."""

    def __init__(self, settings):
        self.settings, self.lock = settings, threading.Lock()
        self.database = sqlite3.connect(settings.state, check_same_thread=False, isolation_level=None)
        self.database.execute(
            "CREATE TABLE IF NOT EXISTS taken (id TEXT, channel TEXT, at REAL, PRIMARY KEY (id, channel))")

    def forward(self, message_id, event):
        """Sends an event to the channels that have not taken it; the names of those that do not."""
        failed, note = [], note_of(event)
        with self.lock:
            self.database.execute("DELETE FROM taken WHERE at < ?", (time.time() - REMEMBERED_S,))
            rows = self.database.execute("SELECT channel FROM taken WHERE id = ?", (message_id,))
            taken = {channel for (channel,) in rows}
            for channel in [name for name in self.settings.channels if name not in taken]:
                try:
                    self.settings.send(channel, note, message_id)
                    self.database.execute("INSERT INTO taken VALUES (?, ?, ?)", (message_id, channel, time.time()))
                except (OSError, smtplib.SMTPException, http.client.HTTPException) as error:
                    # The URL, which is a secret, stays out of the log.
                    reason = type(error).__name__ if isinstance(error, http.client.HTTPException) else error
                    print(f"{channel} did not take {message_id}: {reason}", file=sys.stderr, flush=True)
                    failed.append(channel)
        return failed


def server(settings):
    """A server of webhooks, bound and not yet serving."""
    forwarder = Forwarder(settings)

    class Handler(BaseHTTPRequestHandler):
        timeout = 10
        log_message = lambda *_: None

        def do_POST(self):
            length = self.headers.get("content-length", "")
            if not length.isdecimal() or int(length) > BODY_MAX:
                return self.answer(413)
            body = self.rfile.read(int(length))
            status, text = 500, ""
            try:
                message_id = verify(self.headers, body, settings.secrets, time.time())
                status = 503 if forwarder.forward(message_id, json.loads(body)) else 204
            except Refused as refusal:
                status, text = 401, str(refusal)
            except Exception as error:
                print(f"an event was not forwarded: {type(error).__name__}", file=sys.stderr, flush=True)
            self.answer(status, text)

        def answer(self, status, text=""):
            self.send_response(status)
            self.send_header("content-length", str(len(text)))
            self.end_headers()
            self.wfile.write(text.encode())

    return ThreadingHTTPServer(settings.listen, Handler)


if __name__ == "__main__":
    SETTINGS = Settings(os.environ)
    print(f"forwards to {', '.join(SETTINGS.channels)}; listens on {SETTINGS.listen}", flush=True)
    server(SETTINGS).serve_forever()
