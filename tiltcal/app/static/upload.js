// Files dropped or chosen, sent one after the other as they are.
const gib = (bytes) => Number((bytes / 2 ** 30).toFixed(2));
export default {
  template: `<div class="drop" :class="{ over }" @dragover.prevent="over = true" @dragleave="over = false" @drop.prevent="drop">
      <label>{{ label }} <input type="file" multiple @change="choose" :disabled="busy"></label>
      <progress v-if="busy" :value="share" max="1" :aria-label="'Upload of ' + name"></progress>
      <p v-if="busy" class="soft">{{ name }}: {{ (100 * share).toFixed(0) }} %</p>
      <p v-if="problem" class="bad" role="alert">{{ problem }}</p></div>`,
  props: { label: String, most: Number },
  data: () => ({ over: false, busy: false, share: 0, name: "", problem: "" }),
  methods: {
    drop(event) { this.over = false; this.send([...event.dataTransfer.files]); },
    choose(event) { this.send([...event.target.files]).then(() => { event.target.value = ""; }); },
    async send(files) {
      this.problem = "";
      this.busy = true;
      for (const file of files) {
        if (file.size > this.most) { this.problem = `${file.name} has ${gib(file.size)} GiB, and an upload at most ${gib(this.most)} GiB: nothing was sent. Copy the file into the folder of the workspace; it is then listed here.`; continue; }
        try { this.$emit("uploaded", await this.one(file)); } catch (error) { this.problem = String(error.message || error); }
      }
      this.busy = false;
    },
    one(file) {
      this.name = file.name;
      this.share = 0;
      return new Promise((resolve, reject) => {
        const request = new XMLHttpRequest();
        request.open("PUT", "/upload");
        request.setRequestHeader("X-File-Name", encodeURIComponent(file.name));
        request.upload.onprogress = (event) => { if (event.lengthComputable) this.share = event.loaded / event.total; };
        request.onerror = () => reject(new Error(`${file.name}: the connection was lost; send it again`));
        request.onload = () => {
          const answer = JSON.parse(request.responseText || "{}");
          if (request.status === 200) resolve(answer.name); else reject(new Error(answer.error || `${file.name}: ${request.status}`));
        };
        request.send(file);
      });
    },
  },
};
