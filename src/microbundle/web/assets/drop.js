// Files and folders that are dropped or chosen are copied into the workspace, with the names of their folders.

import { Refused } from "./api.js";
import { byId } from "./shared.js";
import { bytes, counted, trouble } from "./page.js";

export function startDrop(place, open) {
  const take = async (listed) => {
    try {
      const files = await listed;
      if (files.length) await open(await copy(files));
    } catch (error) {
      trouble(error);
    } finally {
      byId("upload").hidden = true;
    }
  };
  for (const id of ["files", "folder"]) {
    byId(id).addEventListener("change", (event) =>
      take([...event.target.files].map((file) => ({ file, path: file.webkitRelativePath || file.name }))),
    );
  }
  let depth = 0;
  const over = (by) => {
    depth = Math.max(0, depth + by);
    place.classList.toggle("over", depth > 0);
  };
  document.addEventListener("dragenter", (event) => {
    if (event.dataTransfer.types.includes("Files")) over(1);
  });
  document.addEventListener("dragleave", () => over(-1));
  document.addEventListener("dragover", (event) => event.preventDefault());
  document.addEventListener("drop", (event) => {
    event.preventDefault();
    over(-depth);
    take(dropped(event.dataTransfer));
  });
}

// Everything in what was dropped, folder by folder.
async function dropped(transfer) {
  const entries = [...transfer.items].map((item) => item.webkitGetAsEntry?.()).filter(Boolean);
  if (!entries.length) return [...transfer.files].map((file) => ({ file, path: file.name }));
  const found = [];
  const walk = async (entry) => {
    if (entry.isFile) {
      const file = await new Promise((kept, failed) => {
        entry.file(kept, failed);
      });
      found.push({ file, path: entry.fullPath.replace(/^\//, "") });
      return;
    }
    const reader = entry.createReader();
    for (;;) {
      const some = await new Promise((kept, failed) => {
        reader.readEntries(kept, failed);
      });
      if (!some.length) return;
      for (const one of some) await walk(one);
    }
  };
  for (const entry of entries) await walk(entry);
  return found;
}

function copy(files) {
  const form = new FormData(),
    size = files.reduce((sum, { file }) => sum + file.size, 0);
  for (const { file, path } of files) form.append("files", file, path);
  byId("upload").hidden = false;
  return new Promise((kept, failed) => {
    const request = new XMLHttpRequest();
    request.open("POST", "/api/uploads");
    request.setRequestHeader("X-Microbundle", "1");
    request.responseType = "json";
    request.upload.addEventListener("progress", ({ loaded, total }) => {
      byId("sent").value = loaded / total;
      byId("sent-note").textContent = `${counted(files.length, "file")}, ${bytes(loaded)} of ${bytes(size)}`;
    });
    request.addEventListener("load", () =>
      request.status < 300
        ? kept(request.response.at)
        : failed(
            new Refused(
              request.response?.error?.kind,
              request.response?.error?.message ?? "The files could not be copied.",
            ),
          ),
    );
    request.addEventListener("error", () =>
      failed(
        new Refused(
          "Unreachable",
          "The files could not be copied: the program does not answer, or refused them as too large.",
        ),
      ),
    );
    request.send(form);
  });
}
