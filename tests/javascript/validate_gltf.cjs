// The Khronos glTF validator on files: prints a JSON list of [file, code, severity, message], severity 0 for errors, 1 for warnings.
// node validate_gltf.cjs FOLDER_WITH_NODE_MODULES FILE...
const { readFileSync } = require("node:fs");
const { createRequire } = require("node:module");
const [folder, ...files] = process.argv.slice(2);
const validator = createRequire(`${folder}/`)("gltf-validator");

(async () => {
  const found = [];
  for (const file of files) {
    const report = await validator.validateBytes(new Uint8Array(readFileSync(file)), { maxIssues: 0 });
    for (const issue of report.issues.messages) found.push([file, issue.code, issue.severity, issue.message]);
  }
  process.stdout.write(JSON.stringify(found));
})();
