//! Documents that grow with the age of a route: sent as they are read.

use axum::body::{Body, Bytes};
use axum::http::header;
use axum::response::{IntoResponse, Response};
use futures::stream;

use crate::store::{Pieces, StoreError};

/// How pieces are written as a document.
pub(super) trait Document<T>: Send + 'static {
    /// The media type of the document.
    const MEDIA_TYPE: &'static str;
    /// Appends the text before the first piece.
    fn begin(&mut self, _text: &mut String) {}
    /// Appends a piece.
    ///
    /// # Errors
    /// If it cannot be written; the document is then cut off.
    fn append(&mut self, piece: T, text: &mut String) -> Result<(), serde_json::Error>;
    /// Appends the text after the last piece.
    fn end(&mut self, _text: &mut String) {}
}

/// A document that is being sent.
struct Sending<T, D> {
    /// The next piece; `None` after the last.
    piece: Option<T>,
    pieces: Pieces<T>,
    document: D,
    /// The text that the next part begins with.
    text: String,
}

/// Sends a document piece by piece, beginning with `first`. If the store fails, the connection is cut, so that the
/// document does not look complete.
pub(super) fn send<T, D>(first: Option<T>, pieces: Pieces<T>, mut document: D) -> Response
where
    T: Send + 'static,
    D: Document<T>,
{
    let mut text = String::new();
    document.begin(&mut text);
    let sending = Sending {
        piece: first,
        pieces,
        document,
        text,
    };
    let body = stream::try_unfold(Some(sending), next_part);
    let media_type = [(header::CONTENT_TYPE, D::MEDIA_TYPE)];
    (media_type, Body::from_stream(body)).into_response()
}

type Sent<T, D> = Option<(Bytes, Option<Sending<T, D>>)>;

async fn next_part<T, D: Document<T>>(
    sending: Option<Sending<T, D>>,
) -> Result<Sent<T, D>, StoreError> {
    let Some(mut sending) = sending else {
        return Ok(None);
    };
    let mut text = std::mem::take(&mut sending.text);
    let Some(piece) = sending.piece.take() else {
        sending.document.end(&mut text);
        return Ok(Some((text.into(), None)));
    };
    if let Err(error) = sending.document.append(piece, &mut text) {
        tracing::error!(%error, "a document cannot be written");
        return Err(StoreError::Unavailable);
    }
    sending.piece = sending.pieces.next().await?;
    Ok(Some((text.into(), Some(sending))))
}

/// Appends the members of a JSON array.
#[derive(Debug, Default)]
pub(super) struct Members {
    any: bool,
}

impl Members {
    /// Appends a member, after a comma if it is not the first.
    ///
    /// # Errors
    /// If it does not serialise.
    pub(super) fn append(
        &mut self,
        member: &impl serde::Serialize,
        text: &mut String,
    ) -> Result<(), serde_json::Error> {
        if self.any {
            text.push(',');
        }
        self.any = true;
        text.push_str(&serde_json::to_string(member)?);
        Ok(())
    }
}
