// Dragging: from where the pointer went down until it is up, or the system takes it away.

// Calls `moved` with each event, and `ended` with whether the drag was completed.
export function drag(event, moved, ended) {
  event.preventDefault();
  event.stopPropagation();
  const end = ({ type }) => {
    for (const [name, heard] of listeners) removeEventListener(name, heard);
    ended(type === "pointerup");
  };
  const listeners = [
    ["pointermove", moved],
    ["pointerup", end],
    ["pointercancel", end],
  ];
  for (const [name, heard] of listeners) addEventListener(name, heard);
}
