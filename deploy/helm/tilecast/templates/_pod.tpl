{{/* What every pod may do: nothing but run. */}}
{{- define "tilecast.pod" -}}
automountServiceAccountToken: false
securityContext:
  runAsNonRoot: true
  runAsUser: 65532
  runAsGroup: 65532
  fsGroup: 65532
  seccompProfile:
    type: RuntimeDefault
{{- end }}
{{- define "tilecast.container" -}}
image: {{ .Values.image | quote }}
securityContext:
  allowPrivilegeEscalation: false
  readOnlyRootFilesystem: true
  capabilities:
    drop: ["ALL"]
{{- end }}
{{- define "tilecast.labels" -}}
app.kubernetes.io/name: tilecast
app.kubernetes.io/instance: {{ .Release.Name }}
{{- end }}
