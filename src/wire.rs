//! Small structured values as bytes, for messages and files: bincode in an envelope that tells a damaged or foreign one.
//!
//! Owns the format. Must not know what is sent, nor how. Big arrays don't pass through here: they travel as
//! they lie in memory.

use serde::Serialize;
use serde::de::DeserializeOwned;

use crate::error::{Error, Result};

const MAGIC: [u8; 4] = *b"HLIO";
/// Raised with every change of what is sent.
const VERSION: u32 = 2;
/// Magic, version, length of the payload, CRC-32 of the payload.
const ENVELOPE_BYTES: usize = 4 + 4 + 8 + 4;
/// Longest payload. What is longer is an array, and should travel as one.
pub const MAX_PAYLOAD_BYTES: usize = 1 << 28;

const CONFIG: bincode::config::Configuration<
    bincode::config::LittleEndian,
    bincode::config::Fixint,
    bincode::config::Limit<MAX_PAYLOAD_BYTES>,
> = bincode::config::legacy().with_limit::<MAX_PAYLOAD_BYTES>();

/// The value in its envelope.
///
/// Errors: a value that can't be serialised, or is longer than [`MAX_PAYLOAD_BYTES`].
pub fn encode<T: Serialize + ?Sized>(value: &T) -> Result<Vec<u8>> {
    let mut bytes = vec![0; ENVELOPE_BYTES];
    append(value, &mut bytes)?;
    let payload = &bytes[ENVELOPE_BYTES..];
    let (length, checksum) = (payload.len() as u64, crc32fast::hash(payload));
    bytes[0..4].copy_from_slice(&MAGIC);
    bytes[4..8].copy_from_slice(&VERSION.to_le_bytes());
    bytes[8..16].copy_from_slice(&length.to_le_bytes());
    bytes[16..20].copy_from_slice(&checksum.to_le_bytes());
    Ok(bytes)
}

/// The value out of its envelope.
///
/// Errors: anything but the exact bytes that [`encode`] gave for a value of this type.
pub fn decode<T: DeserializeOwned>(bytes: &[u8]) -> Result<T> {
    let Some((envelope, payload)) = bytes.split_at_checked(ENVELOPE_BYTES) else {
        return Err(broken(format!("a message of {} bytes is too short", bytes.len())));
    };
    if envelope[0..4] != MAGIC {
        return Err(broken("a message is not of this program".into()));
    }
    if envelope[4..8] != VERSION.to_le_bytes() {
        return Err(broken("a message is of another version of this program".into()));
    }
    if envelope[8..16] != (payload.len() as u64).to_le_bytes() || payload.len() > MAX_PAYLOAD_BYTES {
        return Err(broken("a message was cut".into()));
    }
    if envelope[16..20] != crc32fast::hash(payload).to_le_bytes() {
        return Err(broken("a message was damaged on its way".into()));
    }
    unpack(payload)
}

/// The value's bare bytes, for what has a version and a checksum of its own.
///
/// Errors: as of [`encode`].
pub fn pack<T: Serialize + ?Sized>(value: &T) -> Result<Vec<u8>> {
    let mut bytes = Vec::new();
    append(value, &mut bytes)?;
    Ok(bytes)
}

/// The value out of its bare bytes.
///
/// Errors: bytes that aren't exactly those of one value of this type.
pub fn unpack<T: DeserializeOwned>(payload: &[u8]) -> Result<T> {
    let (value, used) = bincode::serde::decode_from_slice(payload, CONFIG)
        .map_err(|error| broken(format!("a message can't be read: {error}")))?;
    if used != payload.len() {
        return Err(broken("a message holds more than it should".into()));
    }
    Ok(value)
}

fn append<T: Serialize + ?Sized>(value: &T, bytes: &mut Vec<u8>) -> Result<()> {
    let start = bytes.len();
    bincode::serde::encode_into_std_write(value, bytes, CONFIG)
        .map_err(|error| broken(format!("a message can't be written: {error}")))?;
    match bytes.len() - start {
        0..=MAX_PAYLOAD_BYTES => Ok(()),
        length => Err(broken(format!("a message of {length} bytes is longer than the limit"))),
    }
}

fn broken(what: String) -> Error {
    Error::launch(what, "run the same build of heliostat on all nodes")
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use serde::Deserialize;

    use super::*;

    #[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
    enum Sample {
        Nothing,
        Some { name: String, numbers: Vec<f64>, inner: Option<Box<Sample>> },
    }

    fn sample() -> Sample {
        let inner = Some(Box::new(Sample::Nothing));
        Sample::Some { name: "Teekanne, größer".into(), numbers: vec![-0.0, f64::MAX], inner }
    }

    #[test]
    fn values_come_back() {
        for value in [Sample::Nothing, sample()] {
            assert_eq!(decode::<Sample>(&encode(&value).unwrap()).unwrap(), value);
        }
        assert_eq!(
            decode::<std::result::Result<u8, String>>(&encode(&Err::<u8, _>("no")).unwrap()).unwrap(),
            Err("no".into())
        );
    }

    #[test]
    fn the_payload_is_bincode_1_3_bytes() {
        let bytes = encode(&(1u16, "ab", Some(2u32))).unwrap();
        let expected = [1, 0, 2, 0, 0, 0, 0, 0, 0, 0, b'a', b'b', 1, 2, 0, 0, 0];
        assert_eq!(&bytes[ENVELOPE_BYTES..], &expected);
    }

    #[test]
    fn any_changed_cut_or_added_byte_is_noticed() {
        let good = encode(&sample()).unwrap();
        for place in 0..good.len() {
            let mut bad = good.clone();
            bad[place] ^= 0x10;
            assert!(decode::<Sample>(&bad).is_err(), "byte {place} changed");
            assert!(decode::<Sample>(&good[..place]).is_err(), "cut at {place}");
        }
        let longer = [&good[..], &[0]].concat();
        assert!(decode::<Sample>(&longer).is_err());
    }

    #[test]
    fn another_type_or_version_is_an_error() {
        assert!(decode::<u64>(&encode(&1u32).unwrap()).is_err());
        assert!(decode::<u32>(&encode(&1u64).unwrap()).is_err());
        let mut newer = encode(&1u32).unwrap();
        newer[4] += 1;
        assert!(decode::<u32>(&newer).unwrap_err().to_string().contains("version"));
    }

    #[test]
    fn a_length_that_lies_allocates_nothing() {
        // A vector that claims 2^60 elements, in an envelope that is right.
        let liar = encode(&(1u64 << 60)).unwrap();
        assert!(decode::<Vec<u64>>(&liar).is_err());
    }

    proptest! {
        #[test]
        fn random_bytes_are_errors(bytes in proptest::collection::vec(any::<u8>(), 0..200)) {
            prop_assert!(decode::<Sample>(&bytes).is_err());
        }
    }
}
