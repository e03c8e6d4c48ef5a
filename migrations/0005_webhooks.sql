-- Webhooks: who is told of alerts by a POST, and what became of telling them.

CREATE TABLE webhooks (
    webhook_key   INTEGER PRIMARY KEY AUTOINCREMENT,
    -- UUID of version 7 in its usual text: sorts by when the webhook was registered.
    id            TEXT    NOT NULL UNIQUE CHECK (length(id) = 36),
    -- Raised by every edit: the fence of people who edit.
    revision      INTEGER NOT NULL CHECK (revision >= 1),
    -- Where events are sent.
    url           TEXT    NOT NULL CHECK (length(url) BETWEEN 1 AND 2048),
    -- What events are signed with. In plain: a signature cannot be made from a digest of the key.
    secret        BLOB    NOT NULL CHECK (length(secret) = 32),
    -- Kinds of events that are sent: a JSON array of texts, not empty.
    events        TEXT    NOT NULL CHECK (json_array_length(events) >= 1),
    -- Of this route alone; NULL for all routes.
    route_key     INTEGER REFERENCES routes ON DELETE CASCADE,
    description   TEXT,
    -- While it is 0, nothing is sent and what happens is not kept for later.
    active        INTEGER NOT NULL CHECK (active IN (0, 1)),
    -- When its receiver said 410 Gone, which disabled it; NULL once somebody enables it again.
    gone_at_us    INTEGER CHECK (gone_at_us IS NULL OR active = 0),
    created_at_us INTEGER NOT NULL,
    updated_at_us INTEGER NOT NULL
) STRICT;

CREATE INDEX webhooks_by_route ON webhooks (route_key);

-- One for each event and each webhook that is told of it, written with the event itself. An update
-- that waits is deleted when its receiver has taken the same alert as new as that, or newer; and
-- when an attempt for the same alert has failed, while a newer update waits.
CREATE TABLE webhook_deliveries (
    -- In the order of commits; never used again.
    delivery_key    INTEGER PRIMARY KEY AUTOINCREMENT,
    webhook_key     INTEGER NOT NULL REFERENCES webhooks ON DELETE CASCADE,
    -- The same for every attempt: what a receiver knows a repetition by.
    id              TEXT    NOT NULL UNIQUE,
    event           TEXT    NOT NULL CHECK (event IN (
        'alert.raised', 'alert.updated',
        'webhook.test' -- on demand; tried once
    )),
    -- What it tells of: an entry of alert_events and its alert; NULL for a test.
    event_sequence  INTEGER,
    alert_key       INTEGER REFERENCES alerts ON DELETE CASCADE,
    -- Of the alert after the event: whoever was told of this one or a later needs it no more.
    alert_revision  INTEGER CHECK (alert_revision >= 1),
    -- When that happened.
    at_us           INTEGER NOT NULL,
    status          TEXT    NOT NULL CHECK (status IN (
        'pending',   -- an attempt follows at next_attempt_at_us, as long as the webhook is active
        'delivered', -- the receiver answered 2xx
        'failed'     -- no attempt follows
    )),
    -- Attempts so far, and when the last of them ended.
    attempts        INTEGER NOT NULL CHECK (attempts >= 0),
    attempted_at_us INTEGER,
    next_attempt_at_us INTEGER,
    -- How the last attempt ended: the status of an answer, or why there was none.
    answer_status   INTEGER CHECK (answer_status BETWEEN 100 AND 999),
    failure         TEXT    CHECK (failure IN (
        'timeout',         -- no answer in time
        'connection',      -- no connection: refused, cut, or not trusted (TLS)
        'name_unknown',    -- the host's name has no address
        'address_refused', -- the host's addresses are none that webhooks are sent to
        'url_refused',     -- the URL is none that webhooks are sent to, since settings changed
        'broken_answer'    -- what came back was not HTTP
    )),
    CHECK ((event = 'webhook.test') = (alert_key IS NULL)),
    CHECK ((alert_key IS NULL) = (event_sequence IS NULL)),
    CHECK ((alert_key IS NULL) = (alert_revision IS NULL)),
    CHECK ((status = 'pending') = (next_attempt_at_us IS NOT NULL)),
    CHECK ((attempts = 0) = (attempted_at_us IS NULL)),
    CHECK (answer_status IS NULL OR failure IS NULL)
) STRICT;

-- What is sent next to a webhook.
CREATE INDEX webhook_deliveries_pending
    ON webhook_deliveries (webhook_key, next_attempt_at_us, delivery_key) WHERE status = 'pending';
CREATE INDEX webhook_deliveries_by_webhook ON webhook_deliveries (webhook_key, delivery_key);
CREATE INDEX webhook_deliveries_by_alert ON webhook_deliveries (alert_key);
-- What is deleted next.
CREATE INDEX webhook_deliveries_by_time ON webhook_deliveries (at_us);
