//! Coded terms of bones: SNOMED CT, as TotalSegmentator's own table has them and CID 4028 and 4031 of DICOM PS3.16.

/// Of bones of which there is one: code, our name, DICOM's meaning.
const MIDDLE: [(&str, &str, &str); 30] = [
    ("89546000", "skull", "Skull"),
    ("91609006", "mandible", "Mandible"),
    ("21387005", "hyoid", "Hyoid bone"),
    ("56873002", "sternum", "Sternum"),
    ("54735007", "sacrum", "Sacrum"),
    ("14806007", "vertebrae_C1", "C1 vertebra"),
    ("39976000", "vertebrae_C2", "C2 vertebra"),
    ("113205007", "vertebrae_C3", "C3 vertebra"),
    ("5329002", "vertebrae_C4", "C4 vertebra"),
    ("36978003", "vertebrae_C5", "C5 vertebra"),
    ("36054005", "vertebrae_C6", "C6 vertebra"),
    ("87391001", "vertebrae_C7", "C7 vertebra"),
    ("64864005", "vertebrae_T1", "T1 vertebra"),
    ("53733008", "vertebrae_T2", "T2 vertebra"),
    ("1626008", "vertebrae_T3", "T3 vertebra"),
    ("73071006", "vertebrae_T4", "T4 vertebra"),
    ("56401006", "vertebrae_T5", "T5 vertebra"),
    ("45296009", "vertebrae_T6", "T6 vertebra"),
    ("62487009", "vertebrae_T7", "T7 vertebra"),
    ("11068009", "vertebrae_T8", "T8 vertebra"),
    ("82687006", "vertebrae_T9", "T9 vertebra"),
    ("7610001", "vertebrae_T10", "T10 vertebra"),
    ("12989004", "vertebrae_T11", "T11 vertebra"),
    ("23215003", "vertebrae_T12", "T12 vertebra"),
    ("66794005", "vertebrae_L1", "L1 vertebra"),
    ("14293000", "vertebrae_L2", "L2 vertebra"),
    ("36470004", "vertebrae_L3", "L3 vertebra"),
    ("11994002", "vertebrae_L4", "L4 vertebra"),
    ("49668003", "vertebrae_L5", "L5 vertebra"),
    ("65985001", "vertebrae_S1", "S1 vertebra"),
];
/// Of bones of which there are two: code, our name with a place for the side, DICOM's meaning.
const PAIRED: [(&str, &str, &str); 19] = [
    ("51299004", "clavicula_{}", "Clavicle"),
    ("79601000", "scapula_{}", "Scapula"),
    ("85050009", "humerus_{}", "Humerus"),
    ("23416004", "ulna_{}", "Ulna"),
    ("62413002", "radius_{}", "Radius"),
    ("29836001", "hip_{}", "Hip"),
    ("71341001", "femur_{}", "Femur"),
    ("48535007", "rib_{}_1", "First rib"),
    ("78247007", "rib_{}_2", "Second rib"),
    ("25888004", "rib_{}_3", "Third rib"),
    ("25523003", "rib_{}_4", "Fourth rib"),
    ("15339008", "rib_{}_5", "Fifth rib"),
    ("59558009", "rib_{}_6", "Sixth rib"),
    ("24915002", "rib_{}_7", "Seventh rib"),
    ("5953002", "rib_{}_8", "Eighth rib"),
    ("22565002", "rib_{}_9", "Ninth rib"),
    ("77644006", "rib_{}_10", "Tenth rib"),
    ("58830002", "rib_{}_11", "Eleventh rib"),
    ("43993008", "rib_{}_12", "Twelfth rib"),
];
/// Codes of the sides: SNOMED CT's, and SNOMED RT's, which older objects have.
const SIDES: [(&str, &str, &str, &str); 2] =
    [("7771000", "G-A101", "left", "Left"), ("24028007", "G-A100", "right", "Right")];

/// A code of SNOMED CT with its meaning.
pub(super) type Term = (&'static str, &'static str);

/// The bone that a code and that of its side stand for; `None` for codes that are no bone's, and of a bone of which there are
/// two without a side.
pub(super) fn bone_of(code: &str, side: &str) -> Option<String> {
    if let Some((_, bone, _)) = MIDDLE.iter().find(|m| m.0 == code) {
        return Some((*bone).to_owned());
    }
    let (_, pattern, _) = PAIRED.iter().find(|p| p.0 == code)?;
    let (_, _, side, _) = SIDES.iter().find(|s| s.0 == side || s.1 == side)?;
    Some(pattern.replace("{}", side))
}

/// The code of a bone, and that of its side where there are two.
pub(super) fn term_of(bone: &str) -> Option<(Term, Option<Term>)> {
    if let Some((code, _, meaning)) = MIDDLE.iter().find(|m| m.1 == bone) {
        return Some(((*code, *meaning), None));
    }
    SIDES.iter().find_map(|(side, _, name, said)| {
        let (code, _, meaning) = PAIRED.iter().find(|p| p.1.replace("{}", name) == bone)?;
        Some(((*code, *meaning), Some((*side, *said))))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::skeleton::anatomy::Kind;

    #[test]
    fn every_bone_has_a_term_that_leads_back() {
        let mut codes: Vec<&str> = MIDDLE.iter().chain(&PAIRED).map(|m| m.0).collect();
        codes.sort_unstable();
        let all = codes.len();
        codes.dedup();
        assert_eq!(codes.len(), all, "a code stands twice");
        let paired = PAIRED.iter().flat_map(|p| ["left", "right"].map(|side| p.1.replace("{}", side)));
        for bone in MIDDLE.iter().map(|m| m.1.to_owned()).chain(paired) {
            assert!(Kind::of(&bone).is_some(), "{bone}");
            let ((code, _), side) = term_of(&bone).unwrap();
            assert_eq!(bone_of(code, side.map_or("", |s| s.0)), Some(bone));
        }
        assert_eq!(bone_of("71341001", "G-A100"), Some("femur_right".into()));
        assert_eq!(bone_of("71341001", ""), None);
        assert_eq!(bone_of("10200004", "7771000"), None);
    }
}
