//! The router as the service of one connection: adds the client's address to requests, and tracks what the connection is
//! doing.

use std::convert::Infallible;
use std::net::IpAddr;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};

use axum::Router;
use axum::body::{Body, Bytes};
use futures::future::BoxFuture;
use hyper::body::{Body as HttpBody, Frame, Incoming, SizeHint};
use hyper::service::Service;
use hyper::{Request, Response};
use hyper_util::service::TowerToHyperService;

use super::activity::Activity;
use crate::api::{ClientAddress, Held, PeerAddress};

/// Answers the requests of one connection.
pub(super) struct Answering {
    pub router: TowerToHyperService<Router>,
    pub peer: IpAddr,
    pub activity: Arc<Activity>,
}

impl Service<Request<Incoming>> for Answering {
    type Response = Response<AnswerBody>;
    type Error = Infallible;
    type Future = BoxFuture<'static, Result<Self::Response, Infallible>>;

    fn call(&self, mut request: Request<Incoming>) -> Self::Future {
        self.activity.begin();
        let extensions = request.extensions_mut();
        extensions.insert(PeerAddress(self.peer.to_canonical()));
        extensions.insert(ClientAddress::from(self.peer));
        let answer = self.router.call(request);
        let activity = self.activity.clone();
        Box::pin(async move {
            let mut answer = answer.await?;
            activity.hold(answer.extensions_mut().remove::<Held>());
            Ok(answer.map(|body| AnswerBody { body, activity }))
        })
    }
}

/// A body that notes when hyper has taken all of it.
pub(super) struct AnswerBody {
    body: Body,
    activity: Arc<Activity>,
}

impl HttpBody for AnswerBody {
    type Data = Bytes;
    type Error = axum::Error;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, axum::Error>>> {
        Pin::new(&mut self.body).poll_frame(cx)
    }

    fn is_end_stream(&self) -> bool {
        self.body.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        self.body.size_hint()
    }
}

impl Drop for AnswerBody {
    fn drop(&mut self) {
        self.activity.made();
    }
}
