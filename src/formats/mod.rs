//! Bytes and text from outside, to core types and back.

pub mod g2o;
