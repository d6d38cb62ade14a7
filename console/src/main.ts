// The console's page.
import "./look/page.css";
import "./panels/console/index.js";

document.body.append(document.createElement("mom-console"));
