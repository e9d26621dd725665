// Package served runs nmes serve for tests: the program that the environment's variable NMES_PROGRAM names.
package served

import (
	"bufio"
	"encoding/json"
	"os"
	"os/exec"
	"testing"

	"nmes"
)

// Password is that of all servers.
const Password = "sesame"

// Host is a server that runs.
type Host struct {
	// Where its worlds are entered, the first one first.
	Ports []int

	command *exec.Cmd
	folder  string
}

// Start starts a server with these options, in a folder of its own, and waits until it is there.
func Start(t testing.TB, options ...string) *Host {
	t.Helper()
	program := os.Getenv("NMES_PROGRAM")
	if program == "" {
		t.Fatal("set NMES_PROGRAM to the program nmes")
	}
	folder, err := os.MkdirTemp("", "nmes")
	if err != nil {
		t.Fatal(err)
	}
	host := &Host{folder: folder}
	host.command = exec.Command(program, append([]string{"serve", "--json", "--port", "0"}, options...)...)
	host.command.Env = append(os.Environ(), nmes.PasswordVariable+"="+Password)
	host.command.Dir = folder
	out, err := host.command.StdoutPipe()
	if err != nil {
		t.Fatal(err)
	}
	if err := host.command.Start(); err != nil {
		t.Fatal(err)
	}
	line, err := bufio.NewReader(out).ReadString('\n')
	if err != nil {
		host.Stop()
		t.Fatalf("the server said nothing: %v", err)
	}
	var told struct {
		Port   int `json:"port"`
		Worlds []struct {
			Port int `json:"port"`
		} `json:"worlds"`
	}
	if err := json.Unmarshal([]byte(line), &told); err != nil || told.Port == 0 {
		host.Stop()
		t.Fatalf("the server said %s", line)
	}
	host.Ports = []int{told.Port}
	for _, each := range told.Worlds {
		if each.Port != told.Port {
			host.Ports = append(host.Ports, each.Port)
		}
	}
	return host
}

// Stop ends the server, and waits for that.
func (h *Host) Stop() {
	_ = h.command.Process.Signal(os.Interrupt)
	_ = h.command.Wait()
	_ = os.RemoveAll(h.folder)
}
