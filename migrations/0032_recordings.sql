-- Recordings: whole trips that came as one file and were written into batches on arrival.

-- Of the last batch of a recording: the SHA-256 of the file's own SHA-256 and of the parameters that it was sent
-- with, by which a repeated upload is recognised. NULL for every other batch.
ALTER TABLE batches ADD COLUMN recording_sha256 BLOB CHECK (length(recording_sha256) = 32);
