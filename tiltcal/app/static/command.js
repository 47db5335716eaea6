// A command as text, with a button that copies it.
export default {
  template: `<div class="command"><span class="soft">{{ lead }}</span> <code>{{ text }}</code>
    <button type="button" class="small" @click="copy" :aria-label="'Copy the command: ' + text">{{ copied ? "Copied" : "Copy" }}</button></div>`,
  props: { text: String, lead: String },
  data: () => ({ copied: false }),
  methods: {
    async copy() {
      await navigator.clipboard.writeText(this.text);
      this.copied = true;
      setTimeout(() => { this.copied = false; }, 1500);
    },
  },
};
