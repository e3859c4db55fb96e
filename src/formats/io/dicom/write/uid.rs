//! UIDs of what is written: `2.25.` and 128 bits as a decimal number (PS3.5 B.2), which needs no registered root.

use sha2::{Digest, Sha256};

/// A UID that follows from texts, in their order: the same texts give the same UID on every machine.
///
/// The bits are the first 128 of the SHA-256 of the texts and their lengths, so that no two lists of texts run together.
pub fn uid_of(parts: &[&str]) -> String {
    let mut hash = Sha256::new();
    for part in parts {
        hash.update((part.len() as u64).to_le_bytes());
        hash.update(part.as_bytes());
    }
    let digest: [u8; 32] = hash.finalize().into();
    let bits = digest.iter().take(16).fold(0u128, |sum, byte| sum << 8 | u128::from(*byte));
    format!("2.25.{bits}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_uid_follows_from_its_texts_and_their_borders() {
        let uid = uid_of(&["1.2.3", "ct"]);
        assert_eq!(uid, uid_of(&["1.2.3", "ct"]));
        let others = [uid_of(&["1.2.3c", "t"]), uid_of(&["1.2.3ct"]), uid_of(&["ct", "1.2.3"]), uid_of(&[])];
        assert!(others.iter().all(|other| *other != uid));
        for uid in others.iter().chain([&uid]) {
            let number = uid.strip_prefix("2.25.").unwrap();
            // At most 64 characters, no leading zero (PS3.5 9.1).
            assert!(uid.len() <= 44 && number.parse::<u128>().is_ok() && !number.starts_with('0'));
        }
    }

    #[test]
    fn the_number_does_not_change_between_versions() {
        // hashlib.sha256((3).to_bytes(8, "little") + b"abc").digest()[:16], big-endian.
        assert_eq!(uid_of(&["abc"]), "2.25.274578319826780243159830272570465808854");
    }
}
