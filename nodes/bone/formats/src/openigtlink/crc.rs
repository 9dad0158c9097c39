/// The generator polynomial of ECMA-182, without its leading term.
const POLYNOMIAL: u64 = 0x42F0_E1EB_A9EA_3693;

/// The remainder of each leading byte.
const TABLE: [u64; 256] = {
    let mut table = [0; 256];
    let mut byte = 0;
    while byte < table.len() {
        let mut crc = (byte as u64) << 56;
        let mut bit = 0;
        while bit < 8 {
            crc = if crc >> 63 == 1 { crc << 1 ^ POLYNOMIAL } else { crc << 1 };
            bit += 1;
        }
        table[byte] = crc;
        byte += 1;
    }
    table
};

/// The CRC-64 of a body: ECMA-182, most significant bit first, from 0, without a final exclusive or.
pub fn crc64(bytes: &[u8]) -> u64 {
    bytes.iter().fold(0, |crc, &byte| TABLE[usize::from((crc >> 56) as u8 ^ byte)] ^ crc << 8)
}
