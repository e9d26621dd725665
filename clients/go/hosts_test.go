package nmes_test

import (
	"bytes"
	"encoding/json"
	"fmt"
	"net"
	"testing"

	"nmes"
)

// madeUpHost returns the address of a host, which answers each auth with list by what a function makes of its start.
func madeUpHost(t *testing.T, answer func(start int) string) string {
	t.Helper()
	listener, err := net.Listen("tcp", "127.0.0.1:0")
	if err != nil {
		t.Fatal(err)
	}
	t.Cleanup(func() { listener.Close() })
	go func() {
		for {
			socket, err := listener.Accept()
			if err != nil {
				return
			}
			part := make([]byte, 4096)
			n, err := socket.Read(part)
			var asked struct{ Start int }
			if err == nil && json.Unmarshal(bytes.TrimSuffix(part[:n], []byte("<???DONE???---")), &asked) == nil {
				_, _ = fmt.Fprint(socket, answer(asked.Start), "<???DONE???---")
			}
			socket.Close()
		}
	}()
	return listener.Addr().String()
}

func TestAListOfWorldsComesInPages(t *testing.T) {
	options := nmes.Options{Password: password}
	address := madeUpHost(t, func(start int) string {
		next := map[int]string{0: "2", 2: "3", 3: "null"}[start]
		return fmt.Sprintf(`{"type": "world_list", "worlds": [{"world": "from-%d"}], "next": %s}`, start, next)
	})
	worlds, err := nmes.Worlds(within(t), address, options)
	if err != nil || len(worlds) != 3 || worlds[0].World != "from-0" || worlds[1].World != "from-2" || worlds[2].World != "from-3" {
		t.Error(worlds, err)
	}
}

func TestAListThatHasNoEndAndAServerWithoutOneAreTold(t *testing.T) {
	options := nmes.Options{Password: password}
	endless := madeUpHost(t, func(int) string { return `{"type": "world_list", "worlds": [], "next": 1}` })
	if _, err := nmes.Worlds(within(t), endless, options); !nmes.IsCode(err, "bad_reply") {
		t.Error(err)
	}
	older := madeUpHost(t, func(int) string { return `{"type": "auth_success", "world": "main"}` })
	if _, err := nmes.Worlds(within(t), older, options); !nmes.IsCode(err, "unsupported") {
		t.Error(err)
	}
	if _, err := nmes.CreateWorld(within(t), endless, options, nmes.NewWorld{World: "red"}); !nmes.IsCode(err, "bad_reply") {
		t.Error(err)
	}
}
