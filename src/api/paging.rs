//! Lists in parts: a limit and an opaque cursor.

use super::problem::Problem;

const LIMIT_DEFAULT: u32 = 100;
const LIMIT_MAX: u32 = 1_000;

/// The `limit` parameter, checked.
pub(super) fn checked_limit(limit: Option<u32>) -> Result<u32, Problem> {
    match limit.unwrap_or(LIMIT_DEFAULT) {
        limit @ 1..=LIMIT_MAX => Ok(limit),
        _ => Err(Problem::parameter(
            "limit",
            format!("limit is 1 to {LIMIT_MAX}"),
        )),
    }
}

/// The cursor that stands after a key. Hexadecimal keeps it opaque and safe in a URL.
pub(super) fn cursor_after(key: &str) -> String {
    key.bytes().map(|byte| format!("{byte:02x}")).collect()
}

/// The key that a cursor stands after.
pub(super) fn key_of_cursor<K: std::str::FromStr>(
    cursor: Option<&str>,
) -> Result<Option<K>, Problem> {
    let Some(cursor) = cursor else {
        return Ok(None);
    };
    let bytes = (0..cursor.len()).step_by(2).map(|k| {
        let digits = cursor.get(k..k + 2).filter(|d| !d.starts_with('+'))?;
        u8::from_str_radix(digits, 16).ok()
    });
    let key = bytes.collect::<Option<Vec<u8>>>();
    key.and_then(|key| String::from_utf8(key).ok())
        .and_then(|key| key.parse().ok())
        .map(Some)
        .ok_or_else(|| Problem::parameter("cursor", "send the next_cursor of the page before"))
}

/// Cuts a list that was read with one item too many, and says where the next part begins.
pub(super) fn cut_page<T>(
    items: &mut Vec<T>,
    limit: u32,
    key: impl Fn(&T) -> String,
) -> Option<String> {
    if items.len() <= limit as usize {
        return None;
    }
    items.truncate(limit as usize);
    items.last().map(|last| cursor_after(&key(last)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ids::RouteId;

    #[test]
    fn a_cursor_comes_back_as_its_key() {
        let cursor = cursor_after("line-4");
        let key: Option<RouteId> = key_of_cursor(Some(&cursor)).unwrap();
        assert_eq!(key.unwrap().as_str(), "line-4");
        for bad in ["", "zz", "6", "+1", "c3", "ü", "2f"] {
            assert!(key_of_cursor::<RouteId>(Some(bad)).is_err(), "{bad}");
        }
    }

    #[test]
    fn pages_are_cut_where_more_follows() {
        let mut items = vec![1, 2, 3];
        assert_eq!(cut_page(&mut items, 3, i32::to_string), None);
        let cursor = cut_page(&mut items, 2, i32::to_string).unwrap();
        assert_eq!(items, [1, 2]);
        assert_eq!(key_of_cursor::<i32>(Some(&cursor)).unwrap(), Some(2));
    }

    #[test]
    fn limits_are_bounded() {
        assert_eq!(checked_limit(None).unwrap(), LIMIT_DEFAULT);
        assert!(checked_limit(Some(0)).is_err());
        assert!(checked_limit(Some(1_001)).is_err());
    }
}
