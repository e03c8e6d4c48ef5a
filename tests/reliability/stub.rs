//! Services that are broken on purpose: what controls judge.

use axum::Router;
use axum::response::Response;
use tokio::net::TcpListener;

/// Answers every request alike; its address.
pub async fn answering(answer: fn() -> Response) -> String {
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let url = format!("http://{}", listener.local_addr().unwrap());
    let router = Router::new().fallback(async move || answer());
    tokio::spawn(async move { axum::serve(listener, router).await.unwrap() });
    url
}

/// Takes every connection, says nothing and never closes it; its address.
pub async fn silent() -> String {
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let url = format!("http://{}", listener.local_addr().unwrap());
    tokio::spawn(async move {
        let mut held = Vec::new();
        while let Ok((connection, _)) = listener.accept().await {
            held.push(connection);
        }
    });
    url
}
