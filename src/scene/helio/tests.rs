use std::io::Cursor;
use std::path::PathBuf;

use proptest::prelude::*;
use tempfile::TempDir;

use super::*;

/// Two sections, the second not after a multiple of 64 bytes.
fn small() -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut writer = HelioWriter::new(Cursor::new(&mut bytes)).unwrap();
    writer.section("points", &[[1.0f32, 2.0, 3.0], [-4.0, 5.0, 0.5]]).unwrap();
    writer.section("none", &[0u64; 0]).unwrap();
    writer.section("numbers", &[7u64, 8, 9]).unwrap();
    writer.finish().unwrap();
    bytes
}

fn file(folder: &TempDir, bytes: &[u8]) -> PathBuf {
    let path = folder.path().join("small.helio");
    std::fs::write(&path, bytes).unwrap();
    path
}

/// Opens the bytes as a file and reads everything in it.
fn read(folder: &TempDir, bytes: &[u8]) -> crate::error::Result<(Vec<[f32; 3]>, Vec<u64>)> {
    let file = HelioFile::open(&file(folder, bytes))?;
    file.verify::<[f32; 3]>("points", |_, _| Ok(()))?;
    file.verify::<u64>("none", |_, _| Ok(()))?;
    file.verify::<u64>("numbers", |_, _| Ok(()))?;
    assert!(file.section::<u64>("none")?.is_empty());
    Ok((file.section("points")?.to_vec(), file.section("numbers")?.to_vec()))
}

fn message(folder: &TempDir, bytes: &[u8]) -> String {
    let message = read(folder, bytes).unwrap_err().to_string();
    assert!(message.contains("small.helio: "), "{message}");
    message
}

#[test]
fn sections_come_back_aligned_and_shared() {
    let folder = tempfile::tempdir().unwrap();
    let path = file(&folder, &small());
    let opened = HelioFile::open(&path).unwrap();
    let numbers = opened.section::<u64>("numbers").unwrap();
    assert!(numbers.is_mapped() && (numbers.as_ptr() as u64).is_multiple_of(ALIGNMENT));
    assert_eq!(numbers, [7, 8, 9]);
    assert!(opened.optional_section::<u64>("index").unwrap().is_none());
    assert_eq!(opened.path(), path);
    assert_eq!(opened.checksum(), HelioFile::open(&path).unwrap().checksum());
    let message = |error: crate::error::Error| error.to_string();
    assert!(message(opened.section::<u64>("index").unwrap_err()).contains("has no section \"index\""));
    assert!(message(opened.section::<u32>("numbers").unwrap_err()).contains("have 8 bytes, not 4"));
    let mut writer = HelioWriter::new(Cursor::new(Vec::new())).unwrap();
    writer.section("a", &[1u8]).unwrap();
    assert!(writer.section("a", &[1u8]).is_err());
}

#[test]
fn other_contents_have_another_checksum() {
    let folder = tempfile::tempdir().unwrap();
    let checksum = |numbers: [u64; 2]| {
        let mut bytes = Vec::new();
        let mut writer = HelioWriter::new(Cursor::new(&mut bytes)).unwrap();
        writer.section("numbers", &numbers).unwrap();
        writer.finish().unwrap();
        HelioFile::open(&file(&folder, &bytes)).unwrap().checksum()
    };
    assert_eq!(checksum([1, 2]), checksum([1, 2]));
    assert_ne!(checksum([1, 2]), checksum([1, 3]));
}

#[test]
fn what_is_wrong_is_said() {
    let folder = tempfile::tempdir().unwrap();
    let good = small();
    let with = |place: usize, byte: u8| {
        let mut bytes = good.clone();
        bytes[place] = byte;
        bytes
    };
    assert!(message(&folder, &[]).contains("it is no .helio file; convert the scene anew"));
    assert!(message(&folder, b"[camera]").contains("it is no .helio file"));
    assert!(message(&folder, &with(0, b'h')).contains("it is no .helio file"));
    assert!(message(&folder, &with(8, 77)).contains("of version 77, and this program reads 3"));
    let mut turned = good.clone();
    turned[8..12].reverse();
    turned[12..16].reverse();
    assert!(message(&folder, &turned).contains("another byte order"));
    assert!(message(&folder, &good[..40]).contains("its beginning is damaged"));
    assert!(message(&folder, &good[..good.len() - 1]).contains("bytes instead of"));
    assert!(message(&folder, &[&good[..], &[0]].concat()).contains("bytes instead of"));
    assert!(message(&folder, &with(64, 1)).contains("its section \"points\" is damaged"));
    assert!(message(&folder, &with(good.len() - 1, 1)).contains("its table is damaged"));
}

#[test]
fn any_changed_or_missing_byte_is_noticed_or_means_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let good = small();
    let expected = read(&folder, &good).unwrap();
    let mut harmless = 0;
    for place in 0..good.len() {
        let mut bad = good.clone();
        bad[place] ^= 0x41;
        match read(&folder, &bad) {
            Ok(found) => {
                assert_eq!(found, expected);
                harmless += 1;
            }
            Err(error) => assert!(error.to_string().contains("small.helio: "), "{error}"),
        }
        message(&folder, &good[..place]);
    }
    // 16 bytes of the preamble, and two gaps behind 24 bytes.
    assert_eq!(harmless, 16 + 2 * (64 - 24));
}

/// A file whose table says what it likes, under sums that are right.
fn lying(sections: &[Section], preamble: impl FnOnce(&mut Preamble)) -> Vec<u8> {
    let table = crate::wire::pack(sections).unwrap();
    let (offset, bytes) = (256, table.len() as u64);
    let mut head = Preamble {
        magic: MAGIC,
        version: VERSION,
        byte_order: BYTE_ORDER,
        file_bytes: offset + bytes,
        table_offset: offset,
        table_bytes: bytes,
        table_checksum: crc32fast::hash(&table),
        checksum: 0,
        unused: [0; 2],
    };
    preamble(&mut head);
    head.checksum = head.own_checksum();
    let mut file = bytemuck::bytes_of(&head).to_vec();
    file.resize(offset as usize, 0);
    [file, table].concat()
}

fn number() -> impl Strategy<Value = u64> {
    prop_oneof![0u64..300, any::<u64>(), Just(u64::MAX), (0u64..8).prop_map(|k| k * 64)]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    #[test]
    fn tables_that_lie_are_errors_or_lead_into_the_file(
        rows in prop::collection::vec((0..3usize, number(), number(), number()), 0..4),
        (file_bytes, table_offset, table_bytes) in (any::<Option<u8>>(), number(), number()),
        lies in 0..8u8,
    ) {
        let folder = tempfile::tempdir().unwrap();
        let sections: Vec<Section> = rows
            .into_iter()
            .map(|(name, offset, element_bytes, count)| Section {
                name: ["points", "numbers", "header"][name].into(),
                offset,
                element_bytes: if name == 0 { 12 } else { element_bytes },
                count,
                checksum: 0,
            })
            .collect();
        let bytes = lying(&sections, |head| {
            if lies & 1 > 0 {
                head.file_bytes = file_bytes.map_or(u64::MAX, u64::from);
            }
            if lies & 2 > 0 {
                head.table_offset = table_offset;
            }
            if lies & 4 > 0 {
                head.table_bytes = table_bytes;
            }
        });
        match HelioFile::open(&file(&folder, &bytes)) {
            Ok(opened) => {
                if let Ok(Some(points)) = opened.optional_section::<[f32; 3]>("points") {
                    prop_assert!(points.len() * 12 <= bytes.len());
                    // All of them can be touched.
                    points.iter().flatten().map(|c| c.to_bits()).fold(0, u32::max);
                }
                let _ = opened.optional_section::<u64>("numbers");
            }
            Err(error) => prop_assert!(error.to_string().contains("convert the scene anew"), "{error}"),
        }
    }

    #[test]
    fn random_bytes_are_errors(bytes in prop::collection::vec(any::<u8>(), 0..300), known in any::<bool>()) {
        let folder = tempfile::tempdir().unwrap();
        let mut bytes = bytes;
        if known && bytes.len() >= 8 {
            bytes[..8].copy_from_slice(&MAGIC);
        }
        prop_assert!(HelioFile::open(&file(&folder, &bytes)).is_err());
    }
}
