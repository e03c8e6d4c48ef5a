//! MCAP recordings: ROS 2 bags with CDR messages, and Foxglove's JSON messages.
//!
//! A file is read twice, chunk by chunk: [`Survey`] finds the topics, the transforms and the odometry,
//! [`Plan`] decides with a [`TopicChoice`] what is taken, and [`ScanReader`] reads the scans one by one.

mod cdr;
mod container;
mod decode;
mod error;
mod foxglove;
mod messages;
mod odometry;
mod plan;
mod scans;
mod survey;
mod transforms;

pub use container::MAGIC;
pub use error::McapError;
pub use plan::{MountOverride, Plan, TopicChoice};
pub use scans::{McapSkip, ScanReader};
pub use survey::Survey;

#[cfg(test)]
mod tests;
