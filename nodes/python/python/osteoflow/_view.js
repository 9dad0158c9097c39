// The page in a notebook: the address that the kernel serves it at, in a frame. The notebook's own address goes to the kernel first, since the page
// may be shown in frames of that address alone.

/** @param {{model: any, el: HTMLElement}} widget */
function render({ model, el }) {
  const frame = document.createElement("iframe");
  frame.title = "Osteoflow";
  frame.allow = "fullscreen";
  Object.assign(frame.style, { width: "100%", border: "1px solid #8884", display: "block", background: "#8882" });
  const words = document.createElement("p");
  words.setAttribute("role", "status");
  const show = () => {
    frame.style.height = `${model.get("height")}px`;
    const [address, problem] = [model.get("address"), model.get("problem")];
    frame.hidden = address === "";
    words.textContent = problem || (address === "" ? "the page is being started" : "");
    if (address !== "" && frame.getAttribute("src") !== address) frame.src = address;
  };
  for (const key of ["address", "problem", "height"]) model.on(`change:${key}`, show);
  el.append(words, frame);
  show();
  model.send({ origin: location.origin });
}

export default { render };
