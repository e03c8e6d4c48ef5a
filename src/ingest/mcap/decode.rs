//! Messages of a channel to what they say, whatever their encoding.

use super::cdr;
use super::container::Message;
use super::foxglove;
use super::messages::{OdometryMessage, ScanMessage, TransformMessage};

/// A sweep; `None` if the bytes are none.
pub(super) fn scan(message: &Message<'_>) -> Option<ScanMessage> {
    match message.channel.encoding.as_str() {
        "cdr" => cdr::scan(message.data),
        _ => foxglove::scan(message.data),
    }
}

/// A pose of the odometry; `None` if the bytes are none.
pub(super) fn odometry(message: &Message<'_>) -> Option<OdometryMessage> {
    match message.channel.encoding.as_str() {
        "cdr" => cdr::odometry(message.data),
        _ => foxglove::odometry(message.data),
    }
}

/// Transforms; none if the bytes are none.
pub(super) fn transforms(message: &Message<'_>) -> Vec<TransformMessage> {
    match message.channel.encoding.as_str() {
        "cdr" => cdr::transforms(message.data),
        _ => foxglove::transforms(message.data, &message.channel.schema),
    }
}
