//! Texts by their Specific Character Set (PS3.3 C.12.1.1.2), with the code extensions of ISO 2022 (PS3.5 6.1.2).

use encoding_rs::{
    EUC_JP, EUC_KR, Encoding, GB18030, GBK, ISO_8859_2, ISO_8859_3, ISO_8859_4, ISO_8859_5, ISO_8859_6, ISO_8859_7,
    ISO_8859_8, ISO_8859_15, SHIFT_JIS, UTF_8, WINDOWS_874, WINDOWS_1254,
};

const ESCAPE: u8 = 0x1b;

/// The character set that a data set names first.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) struct Charset(High);

/// What bytes above 127 mean.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
enum High {
    /// Latin alphabet no. 1, and what is not told.
    #[default]
    Latin,
    /// One or two bytes of a set that may be switched to others.
    Part(&'static Encoding),
    /// An encoding of all bytes.
    Whole(&'static Encoding),
}

/// What bytes below 128 mean.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Low {
    Ascii,
    /// Pairs of a set whose bytes have the highest bit, with what stands before each.
    Pairs(&'static Encoding, &'static [u8]),
}

impl Charset {
    /// By the values of Specific Character Set.
    pub(super) fn of<S: AsRef<str>>(values: &[S]) -> Self {
        let plain: String = values
            .first()
            .map_or("", AsRef::as_ref)
            .chars()
            .filter(char::is_ascii_alphanumeric)
            .map(|c| c.to_ascii_uppercase())
            .collect();
        let number = plain.strip_prefix("ISO2022IR").or_else(|| plain.strip_prefix("ISOIR"));
        Self(match (number, plain.as_str()) {
            (Some("13"), _) => High::Part(SHIFT_JIS),
            (Some("58"), _) => High::Part(GBK),
            (Some("101"), _) => High::Part(ISO_8859_2),
            (Some("109"), _) => High::Part(ISO_8859_3),
            (Some("110"), _) => High::Part(ISO_8859_4),
            (Some("126"), _) => High::Part(ISO_8859_7),
            (Some("127"), _) => High::Part(ISO_8859_6),
            (Some("138"), _) => High::Part(ISO_8859_8),
            (Some("144"), _) => High::Part(ISO_8859_5),
            (Some("148"), _) => High::Part(WINDOWS_1254),
            (Some("149"), _) => High::Part(EUC_KR),
            (Some("166"), _) => High::Part(WINDOWS_874),
            (Some("203"), _) => High::Part(ISO_8859_15),
            (Some("192"), _) => High::Whole(UTF_8),
            (_, "GB18030") => High::Whole(GB18030),
            (_, "GBK" | "GB2312") => High::Whole(GBK),
            _ => High::Latin,
        })
    }

    /// The text of bytes; `person` where it is a name, whose parts begin anew.
    pub(super) fn text(self, bytes: &[u8], person: bool) -> String {
        match self.0 {
            High::Whole(all) => return all.decode_without_bom_handling(bytes).0.into_owned(),
            // Single bytes in the standard, pairs of bytes in practice.
            High::Part(own) if !bytes.contains(&ESCAPE) => {
                return own.decode_without_bom_handling(bytes).0.into_owned();
            }
            _ => {}
        }
        let (mut low, mut high) = (Low::Ascii, self.0);
        let mut text = String::with_capacity(bytes.len());
        let mut rest = bytes;
        while let Some(first) = rest.first().copied() {
            if first == ESCAPE {
                match designated(&rest[1..]) {
                    Some((length, set)) => {
                        match set {
                            Set::Low(set) => low = set,
                            Set::High(set) => high = set,
                        }
                        rest = &rest[1 + length..];
                    }
                    None => {
                        text.push(char::REPLACEMENT_CHARACTER);
                        rest = &rest[1..];
                    }
                }
                continue;
            }
            let delimits = match first {
                b'\r' | b'\n' | b'\t' | 0x0c => true,
                b'\\' => low == Low::Ascii,
                b'^' | b'=' => person && low == Low::Ascii,
                _ => false,
            };
            if delimits {
                text.push(char::from(first));
                (low, high) = (Low::Ascii, self.0);
                rest = &rest[1..];
                continue;
            }
            let upper = first >= 0x80;
            let same = |b: &&u8| (**b >= 0x80) == upper && **b != ESCAPE && (upper || !ends(**b, low, person));
            let length = rest.iter().take_while(same).count().max(1);
            let (run, after) = rest.split_at(length);
            if upper {
                above(run, high, &mut text)
            } else {
                below(run, low, &mut text)
            }
            rest = after;
        }
        text
    }
}

/// Whether a byte ends a run of bytes below 128.
fn ends(byte: u8, low: Low, person: bool) -> bool {
    matches!(byte, b'\r' | b'\n' | b'\t' | 0x0c)
        || low == Low::Ascii && (byte == b'\\' || person && matches!(byte, b'^' | b'='))
}

fn above(run: &[u8], high: High, text: &mut String) {
    match high {
        High::Latin => text.extend(run.iter().map(|b| char::from(*b))),
        High::Part(set) | High::Whole(set) => text.push_str(&set.decode_without_bom_handling(run).0),
    }
}

fn below(run: &[u8], low: Low, text: &mut String) {
    match low {
        Low::Ascii => text.extend(run.iter().map(|b| char::from(*b))),
        Low::Pairs(set, before) => {
            let mut bytes = Vec::with_capacity(3 * run.len());
            for pair in run.chunks(2) {
                match pair {
                    // A space does not belong to the set.
                    [b' ', other] => bytes.extend([b' ', *other]),
                    [a, b] => {
                        bytes.extend(before);
                        bytes.extend([a | 0x80, b | 0x80]);
                    }
                    _ => bytes.extend(pair),
                }
            }
            text.push_str(&set.decode_without_bom_handling(&bytes).0);
        }
    }
}

enum Set {
    Low(Low),
    High(High),
}

/// The set that an escape sequence switches to (PS3.3 tables C.12-3, C.12-4), and the length of the sequence.
fn designated(bytes: &[u8]) -> Option<(usize, Set)> {
    const JAPANESE: Set = Set::Low(Low::Pairs(EUC_JP, &[]));
    let part = |set: &'static Encoding| Set::High(High::Part(set));
    Some(match bytes {
        [b'(', b'B' | b'J', ..] => (2, Set::Low(Low::Ascii)),
        [b')', b'I', ..] => (2, part(SHIFT_JIS)),
        [b'$', b'B' | b'@', ..] => (2, JAPANESE),
        [b'$', b'(', b'B' | b'@', ..] => (3, JAPANESE),
        [b'$', b'(', b'D', ..] => (3, Set::Low(Low::Pairs(EUC_JP, &[0x8f]))),
        [b'$', b'(', b'C', ..] => (3, Set::Low(Low::Pairs(EUC_KR, &[]))),
        [b'$', b'A', ..] => (2, Set::Low(Low::Pairs(GBK, &[]))),
        [b'$', b'(', b'A', ..] => (3, Set::Low(Low::Pairs(GBK, &[]))),
        [b'$', b')', b'C', ..] => (3, part(EUC_KR)),
        [b'$', b')', b'A', ..] => (3, part(GBK)),
        [b'$', b')', b'B', ..] => (3, part(EUC_JP)),
        [b'-', b'A', ..] => (2, Set::High(High::Latin)),
        [b'-', b'B', ..] => (2, part(ISO_8859_2)),
        [b'-', b'C', ..] => (2, part(ISO_8859_3)),
        [b'-', b'D', ..] => (2, part(ISO_8859_4)),
        [b'-', b'F', ..] => (2, part(ISO_8859_7)),
        [b'-', b'G', ..] => (2, part(ISO_8859_6)),
        [b'-', b'H', ..] => (2, part(ISO_8859_8)),
        [b'-', b'L', ..] => (2, part(ISO_8859_5)),
        [b'-', b'M', ..] => (2, part(WINDOWS_1254)),
        [b'-', b'T', ..] => (2, part(WINDOWS_874)),
        [b'-', b'b', ..] => (2, part(ISO_8859_15)),
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn name(sets: &str, bytes: &[u8]) -> String {
        Charset::of(&sets.split('\\').collect::<Vec<_>>()).text(bytes, true)
    }

    #[test]
    fn names_of_the_standard_are_read() {
        // PS3.5 H.3.1, H.3.2, I.2, K.2; J.3 by pydicom's tests.
        let yamada = b"Yamada^Tarou=\x1b$B;3ED\x1b(B^\x1b$BB@O:\x1b(B=\x1b$B$d$^$@\x1b(B^\x1b$B$?$m$&\x1b(B";
        assert_eq!(name("\\ISO 2022 IR 87", yamada), "Yamada^Tarou=山田^太郎=やまだ^たろう");
        let half =
            b"\xd4\xcf\xc0\xde^\xc0\xdb\xb3=\x1b$B;3ED\x1b(J^\x1b$BB@O:\x1b(J=\x1b$B$d$^$@\x1b(J^\x1b$B$?$m$&\x1b(J";
        assert_eq!(name("ISO 2022 IR 13\\ISO 2022 IR 87", half), "ﾔﾏﾀﾞ^ﾀﾛｳ=山田^太郎=やまだ^たろう");
        let hong = b"Hong^Gildong=\x1b$)C\xfb\xf3^\x1b$)C\xd1\xce\xd4\xd7=\x1b$)C\xc8\xab^\x1b$)C\xb1\xe6\xb5\xbf";
        assert_eq!(name("\\ISO 2022 IR 149", hong), "Hong^Gildong=洪^吉洞=홍^길동");
        let zhang = b"Zhang^XiaoDong=\x1b$)A\xd5\xc5^\x1b$)A\xd0\xa1\xb6\xab=";
        assert_eq!(name("\\ISO 2022 IR 58", zhang), "Zhang^XiaoDong=张^小东=");
    }

    #[test]
    fn every_escape_sequence_switches_to_its_set() {
        for (bytes, text) in [
            (&b"\x1b-A\xe4"[..], "ä"),
            (b"\x1b-B\xb3", "ł"),
            (b"\x1b-C\xe6", "ĉ"),
            (b"\x1b-D\xe0", "ā"),
            (b"\x1b-F\xc4\xe9", "Δι"),
            (b"\x1b-G\xe2", "ق"),
            (b"\x1b-H\xf9", "ש"),
            (b"\x1b-L\xbb\xee\xda", "Люк"),
            (b"\x1b-M\xfe", "ş"),
            (b"\x1b-T\xa1", "ก"),
            (b"\x1b-b\xa4", "€"),
            (b"\x1b)I\xd4", "ﾔ"),
            (b"\x1b$(D0!\x1b(B", "丂"),
            (b"a\x1b$@;3\x1b(Bb", "a山b"),
            (b"a\x1b-F\xc4\r\n\xc4", "aΔ\r\n\u{c4}"),
            (b"a\x1b%Zb", "a\u{fffd}%Zb"),
        ] {
            assert_eq!(name("ISO 2022 IR 6\\ISO 2022 IR 100", bytes), text);
        }
        // The byte of a backslash within a pair separates nothing.
        assert_eq!(name("\\ISO 2022 IR 87", b"\x1b$B%\\\x1b(B"), "ボ");
    }

    #[test]
    fn sets_without_extensions_are_read() {
        for (set, bytes, text) in [
            ("", &b"J\xfcrgen"[..], "Jürgen"),
            ("ISO_IR 6", b"plain", "plain"),
            ("ISO_IR 100", b"J\xfcrgen", "Jürgen"),
            ("iso_ir 144", b"\xbb\xee\xda", "Люк"),
            ("ISO_IR 148", b"\xde", "Ş"),
            ("ISO_IR 166", b"\xa1", "ก"),
            ("ISO_IR 13", b"\xd4\xcf", "ﾔﾏ"),
            ("ISO_IR 192", "Jürgen 山".as_bytes(), "Jürgen 山"),
            ("GB18030", b"\xcd\xf5^\xd0\xa1", "王^小"),
            ("GBK", b"\xcd\xf5", "王"),
            ("no set", b"\xe4", "ä"),
        ] {
            assert_eq!(name(set, bytes), text, "{set}");
        }
    }
}
