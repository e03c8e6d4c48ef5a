//! Who may do what: roles, and the names of those who have them.

use super::audit::{LOCAL, SYSTEM};
use super::text_enum;

/// Most characters of a holder's name.
const NAME_CHARS_MAX: usize = 100;

text_enum! {
    /// What the holder of a key may do. Each may do what the one before it may, but for uploads: viewers
    /// only read.
    Role {
        /// Uploads, and reads what became of it.
        Vehicle = "vehicle",
        /// Reads.
        Viewer = "viewer",
        /// Decides about alerts, and keeps routes and vehicles.
        Maintainer = "maintainer",
        /// Also makes keys and webhooks, and deletes routes.
        Admin = "admin",
    }
}

/// Why a name is refused.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum InvalidHolder {
    /// It is none.
    #[error(
        "a name has 1 to 100 characters, none of them a control character, and no space at its ends"
    )]
    Form,
    /// It stands for somebody else.
    #[error(
        "\"system\" and \"local\" stand for the service and for unknown clients: give another name"
    )]
    Reserved,
}

/// The name of a person or a machine.
///
/// # Errors
/// [`InvalidHolder`].
pub fn checked_holder(name: &str) -> Result<&str, InvalidHolder> {
    let is_long = name.chars().count() > NAME_CHARS_MAX;
    if name.is_empty() || name.trim() != name || is_long || name.chars().any(char::is_control) {
        return Err(InvalidHolder::Form);
    }
    match [SYSTEM, LOCAL]
        .iter()
        .any(|own| name.eq_ignore_ascii_case(own))
    {
        true => Err(InvalidHolder::Reserved),
        false => Ok(name),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nobody_is_called_as_the_service_is() {
        for good in ["Kim", "J. Kovács", "agv-07", &"x".repeat(100)] {
            assert_eq!(checked_holder(good), Ok(good));
        }
        for bad in ["", " kim", "kim\n", "a\0", &"x".repeat(101)] {
            assert_eq!(checked_holder(bad), Err(InvalidHolder::Form), "{bad:?}");
        }
        for bad in ["system", "System", "LOCAL"] {
            assert_eq!(checked_holder(bad), Err(InvalidHolder::Reserved));
        }
    }

    #[test]
    fn roles_are_ordered() {
        assert!(Role::Vehicle < Role::Viewer && Role::Viewer < Role::Maintainer);
        assert!(Role::Maintainer < Role::Admin);
    }
}
