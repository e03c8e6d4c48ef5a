//! The fields as they are sent, bounded while they are read.

use std::fmt;
use std::marker::PhantomData;

use serde::Deserialize;
use serde::de::{Deserializer, Error, IgnoredAny, SeqAccess, Visitor};

use super::uploaded::{EDGES_MAX, NODES_MAX};
use crate::ids::{TripId, VehicleId};
use crate::ingest::batch_json::Pose;
use crate::ingest::extensions::Extensions;
use crate::ingest::json::Object;
use crate::ingest::stamp::SentStamp;
use crate::model::EdgeKind;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Batch {
    pub vehicle_id: VehicleId,
    pub trip_id: Option<TripId>,
    pub nodes: Bounded<Node, NODES_MAX>,
    pub edges: Bounded<Edge, EDGES_MAX>,
    pub extensions: Option<Extensions>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Node {
    pub id: Name,
    pub pose: Object<Pose>,
    pub stamp: Option<SentStamp>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Edge {
    pub from: Name,
    pub to: Name,
    pub measurement: Object<Pose>,
    pub information: [f64; 6],
    pub kind: EdgeKind,
}

/// A node's name: a text, or a whole number as its digits.
pub(super) struct Name(pub String);

impl<'de> Deserialize<'de> for Name {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct NameVisitor;
        impl Visitor<'_> for NameVisitor {
            type Value = Name;
            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a node's id: a text or a whole number")
            }
            fn visit_str<E: Error>(self, name: &str) -> Result<Name, E> {
                Ok(Name(name.to_owned()))
            }
            fn visit_u64<E: Error>(self, number: u64) -> Result<Name, E> {
                Ok(Name(number.to_string()))
            }
            fn visit_i64<E: Error>(self, number: i64) -> Result<Name, E> {
                Ok(Name(number.to_string()))
            }
        }
        deserializer.deserialize_any(NameVisitor)
    }
}

/// The items up to a limit, and how many there were.
pub(super) struct Bounded<T, const MAX: usize> {
    pub kept: Vec<T>,
    pub count: usize,
}

impl<'de, T: Deserialize<'de>, const MAX: usize> Deserialize<'de> for Bounded<T, MAX> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct BoundedVisitor<T, const MAX: usize>(PhantomData<T>);
        impl<'de, T: Deserialize<'de>, const MAX: usize> Visitor<'de> for BoundedVisitor<T, MAX> {
            type Value = Bounded<T, MAX>;
            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("an array of objects")
            }
            fn visit_seq<A: SeqAccess<'de>>(self, mut seq: A) -> Result<Bounded<T, MAX>, A::Error> {
                let mut kept = Vec::new();
                while kept.len() < MAX {
                    let Some(Object(item)) = seq.next_element::<Object<T>>()? else {
                        let count = kept.len();
                        return Ok(Bounded { kept, count });
                    };
                    kept.push(item);
                }
                let mut count = kept.len();
                while seq.next_element::<IgnoredAny>()?.is_some() {
                    count += 1;
                }
                Ok(Bounded { kept, count })
            }
        }
        deserializer.deserialize_seq(BoundedVisitor(PhantomData))
    }
}
