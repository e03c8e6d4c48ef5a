-- The names of people, and their addresses, are replaced by 'redacted' when their time is over. Whatever the service
-- calls itself stays: 'system' and 'local'.

-- When the present assignee was named. NULL without one.
ALTER TABLE alert_handling ADD COLUMN assigned_at_us INTEGER
    CHECK (assigned_at_us IS NULL OR assignee IS NOT NULL);
-- Of those that are there the audit knows it.
UPDATE alert_handling SET assigned_at_us = (
    SELECT coalesce(max(audit.at_us), alerts.updated_at_us)
    FROM alerts LEFT JOIN audit ON audit.subject = alerts.id AND audit.action = 'alert.assigned'
    WHERE alerts.alert_key = alert_handling.alert_key)
WHERE assignee IS NOT NULL;

-- What is redacted next. Rows without a name, and those that were redacted, are in none of these.
CREATE INDEX alert_history_with_names ON alert_history (at_us)
    WHERE by_whom NOT IN ('system', 'local', 'redacted');
CREATE INDEX alert_comments_with_names ON alert_comments (at_us)
    WHERE by_whom NOT IN ('system', 'local', 'redacted');
CREATE INDEX alert_handling_with_names ON alert_handling (assigned_at_us)
    WHERE assignee NOT IN ('system', 'local', 'redacted');
CREATE INDEX map_versions_with_causes ON map_versions (created_at_us)
    WHERE cause_by NOT IN ('system', 'local', 'redacted');
CREATE INDEX map_versions_with_releases ON map_versions (released_at_us)
    WHERE released_by NOT IN ('system', 'local', 'redacted');
-- Every change that people make has an address; the service itself has none.
CREATE INDEX audit_with_names ON audit (at_us) WHERE address <> 'redacted';
-- Alerts that were accepted together were accepted by one person.
CREATE INDEX inputs_with_names ON inputs (at_us)
    WHERE coalesce(json_extract(input, '$.decision.by'), json_extract(input, '$.version_released.by'),
        json_extract(input, '$.accepted_together.alerts[0].by')) NOT IN ('system', 'local', 'redacted');
-- What is still to be carried out needs its names.
CREATE INDEX operations_with_names ON operations (asked_at_us)
    WHERE ended_at_us IS NOT NULL AND json_extract(request, '$.actor.address') <> 'redacted';
