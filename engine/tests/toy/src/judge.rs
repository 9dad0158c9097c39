use crate::Number;
use osteoflow_node::{
    Context, Describe, Function, Inputs, NodeError, Outputs, Payload, SchemaEntry, View, ViewError, schemars, serde,
    serde_json::{self, json},
};

macro_rules! json_payload {
    ($(#[$doc:meta])* $name:ident, $full_name:literal) => {
        $(#[$doc])*
        #[derive(Debug, Clone, PartialEq)]
        pub struct $name(pub serde_json::Value);

        impl Payload<$name> for $name {
            const NAME: &'static str = $full_name;
            const VERSION: u32 = 1;
            const SCHEMA: &'static [SchemaEntry] = &[SchemaEntry::text("json")];

            fn to_view(&self) -> View {
                View::new().with("json", self.0.to_string())
            }

            fn from_view(view: &View) -> Result<Self, ViewError> {
                let json = serde_json::from_str(view.text("json")?);
                Ok(Self(json.map_err(|error| ViewError::Invalid(error.to_string()))?))
            }

            fn to_result(&self) -> serde_json::Value {
                self.0.clone()
            }
        }
    };
}

json_payload! {
    /// What a judge says, which may be no verdict.
    Judgement, "toy/Judgement"
}
json_payload! {
    /// A remark on how a run went.
    Remark, "report/Remark"
}

#[derive(serde::Deserialize, schemars::JsonSchema)]
#[serde(default, deny_unknown_fields, crate = "serde")]
#[schemars(crate = "schemars")]
pub struct JudgeParams {
    /// What it says of each number in turn, the last of all others too; if empty, it judges by the limits.
    says: Vec<serde_json::Value>,
    /// Numbers above are doubtful.
    doubtful_above: f64,
    /// Numbers above are refused.
    refused_above: f64,
}

impl Default for JudgeParams {
    fn default() -> Self {
        Self { says: Vec::new(), doubtful_above: f64::MAX, refused_above: f64::MAX }
    }
}

/// Says whether numbers can be trusted, or anything else that it is told to say.
#[derive(Describe)]
pub struct Judge;

#[derive(Inputs)]
pub struct JudgeIn {
    /// The number to judge.
    number: Number,
}

#[derive(Outputs)]
pub struct JudgeOut {
    /// The verdict.
    verdict: Judgement,
    /// The number, as a report.
    remark: Remark,
}

impl Function for Judge {
    const KIND: &'static str = "toy.judge";
    type Params = JudgeParams;
    type Inputs = JudgeIn;
    type Outputs = JudgeOut;

    fn process(params: &JudgeParams, i: JudgeIn, ctx: &mut Context) -> Result<JudgeOut, NodeError> {
        let number = i.number.0;
        let line = params.says.get(ctx.item() as usize).or(params.says.last());
        let verdict = line.cloned().unwrap_or_else(|| params.judge(number));
        Ok(JudgeOut { verdict: Judgement(verdict), remark: Remark(json!({ "number": number })) })
    }
}

impl JudgeParams {
    fn judge(&self, number: f64) -> serde_json::Value {
        let answer = match number {
            x if x > self.refused_above => "refused",
            x if x > self.doubtful_above => "doubtful",
            _ => "trusted",
        };
        let reason = json!({
            "rule": "size", "answer": answer, "reason": format!("{number} is too large"), "remedy": "take a smaller number",
        });
        let reasons: Vec<_> = (answer != "trusted").then_some(reason).into_iter().collect();
        json!({ "answer": answer, "reasons": reasons, "assumptions": ["numbers are finite"], "predicted": null })
    }
}
