//! Single words of OBJ and MTL files.

/// A material's name as `usemtl` and `newmtl` give it; some files leave it empty.
pub(super) fn name(rest: &[u8]) -> String {
    match String::from_utf8_lossy(rest).trim() {
        "" => "unnamed".to_owned(),
        name => name.to_owned(),
    }
}

/// A word of a file as an error may show it: on one line, and not too long.
pub(super) fn shown(word: &[u8]) -> String {
    let text = String::from_utf8_lossy(word);
    let mut short: String =
        text.chars().map(|c| if c.is_control() { '\u{fffd}' } else { c }).take(40).collect();
    if text.chars().nth(40).is_some() {
        short.push_str("...");
    }
    short
}
