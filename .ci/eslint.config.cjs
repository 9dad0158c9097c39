// The recommended rules of ESLint for the page's scripts and those of the tests. It and its two packages are installed beside each other:
// `npm install --global eslint @eslint/js globals`; .ci/run skips it by name where they are not.
const globals = require("globals");

module.exports = [
  { ignores: ["**/target/", "**/three/"] },
  require("@eslint/js").configs.recommended,
  { languageOptions: { globals: { ...globals.browser, ...globals.node } } },
];
