/// The mark of the table of payloads: `impl Payload<Table> for Cloud`.
pub struct Table;
