//! Version 4: a header in plain bytes, extensions, a table of streams, and a Zstandard frame for each array.

use std::io::Read;

use rayon::prelude::*;
use ruzstd::decoding::StreamingDecoder;

use super::super::error::LoadError;
use super::super::progress::Work;
use super::super::source::Source;
use super::extensions::{Extensions, MOST_BYTES};
use super::read::Header;
use super::{STREAM_ENTRY, STREAMS_HEADER, Sizes};

/// The arrays, unpacked, and what extensions say.
pub(super) fn read(
    source: &Source<'_>,
    header: &Header,
    sizes: Sizes,
    work: &Work<'_>,
) -> Result<([Vec<u8>; 6], Extensions), LoadError> {
    let file = source.name();
    let mut head = [0; STREAMS_HEADER];
    source.read_at(0, &mut head, "header")?;
    let stream_count = usize::from(head[15]);
    let table_start = u64::from(u32::from_le_bytes([head[16], head[17], head[18], head[19]]));
    if table_start < STREAMS_HEADER as u64 {
        let expected = format!("{STREAMS_HEADER} or more");
        return Err(LoadError::invalid(file, "tocByteOffset", expected, table_start.to_string()));
    }
    let extensions = extensions(source, header, table_start)?;

    let wanted = sizes.in_order().map(|size| header.count * size);
    let present: Vec<usize> = (0..wanted.len()).filter(|k| wanted[*k] > 0).collect();
    if stream_count != present.len() {
        let expected = format!("{} streams for degree {}", present.len(), header.sh_degree);
        return Err(LoadError::invalid(file, "numStreams", expected, stream_count.to_string()));
    }
    let mut table = vec![0; stream_count * STREAM_ENTRY];
    source.read_at(table_start, &mut table, "table of streams")?;
    let mut offset = table_start + table.len() as u64;
    let mut streams = Vec::with_capacity(stream_count);
    for (entry, k) in table.as_chunks::<8>().0.as_chunks::<2>().0.iter().zip(present) {
        let [compressed, uncompressed] = entry.map(u64::from_le_bytes);
        if uncompressed != wanted[k] as u64 {
            let field = format!("uncompressed size of stream {}", NAMES[k]);
            return Err(LoadError::invalid(file, field, wanted[k].to_string(), uncompressed.to_string()));
        }
        source.check_extent(offset, compressed, NAMES[k])?;
        streams.push((k, offset, compressed));
        offset += compressed;
    }
    if offset != source.len() {
        let expected = format!("streams up to the end of the file, {}", source.len());
        return Err(LoadError::invalid(file, "table of streams", expected, offset.to_string()));
    }
    let unpacked = streams
        .into_par_iter()
        .map(|(k, offset, compressed)| {
            // Within the file, and so within memory's reach, by the check above.
            let mut bytes = vec![0; compressed as usize];
            source.read_at(offset, &mut bytes, NAMES[k])?;
            let array = unpack(file, NAMES[k], &bytes, wanted[k])?;
            work.add(array.len());
            Ok((k, array))
        })
        .collect::<Result<Vec<_>, LoadError>>()?;
    let mut arrays = [const { Vec::new() }; 6];
    for (k, array) in unpacked {
        arrays[k] = array;
    }
    Ok((arrays, extensions))
}

/// The streams in the order of the file.
const NAMES: [&str; 6] = ["positions", "alphas", "colors", "scales", "rotations", "sh"];

/// What lies between the header and the table.
fn extensions(source: &Source<'_>, header: &Header, table_start: u64) -> Result<Extensions, LoadError> {
    let length = table_start - STREAMS_HEADER as u64;
    if !header.is_extended || length == 0 {
        return Ok(Extensions::default());
    }
    if length > MOST_BYTES as u64 {
        let expected = format!("at most {MOST_BYTES} bytes");
        return Err(LoadError::invalid(source.name(), "extensions", expected, length.to_string()));
    }
    let mut records = vec![0; length as usize];
    source.read_at(STREAMS_HEADER as u64, &mut records, "extensions")?;
    Extensions::read(source.name(), &records)
}

/// The `size` bytes of a frame, no less and no more, with the checksum that the frame states.
fn unpack(file: &str, field: &str, frame: &[u8], size: usize) -> Result<Vec<u8>, LoadError> {
    let expected = || format!("a Zstandard frame of {size} bytes");
    let invalid = |actual: String| LoadError::invalid(file, field, expected(), actual);
    let mut decoder = StreamingDecoder::new(frame).map_err(|error| invalid(error.to_string()))?;
    // Memory grows with what is there: a frame that states more than it has takes none.
    let mut array = Vec::new();
    let read = (&mut decoder).take(size as u64 + 1).read_to_end(&mut array);
    read.map_err(|error| invalid(error.to_string()))?;
    if array.len() != size {
        let actual = if array.len() > size { "more".to_owned() } else { array.len().to_string() };
        return Err(invalid(actual));
    }
    let (stated, actual) =
        (decoder.decoder.get_checksum_from_data(), decoder.decoder.get_calculated_checksum());
    match (stated, actual) {
        (Some(stated), Some(actual)) if stated != actual => Err(LoadError::invalid(
            file,
            format!("checksum of {field}"),
            format!("{stated:08x}"),
            format!("{actual:08x}"),
        )),
        _ => Ok(array),
    }
}
